"""`ur_robot.py` on ROS 2, by Cyclone DDS; see there."""
import time

import ros2_types as ros
import ur_robot


def header(frame=''):
    now = time.time_ns()
    return ros.Header(ros.Time(now // 10**9, now % 10**9), frame)


class Network:
    def __init__(self, arm, tracker):
        node = ros.Node()
        self.arm, self.tracker = arm, tracker
        # As forward_command_controller's: reliable, the newest counts.
        self.commands = node.reader('/forward_velocity_controller/commands', ros.Float64MultiArray, depth=1)
        self.frames = node.reader('/tf_static', ros.TFMessage, latched=True)
        self.states = node.writer('/joint_states', ros.JointState)
        self.shapes = node.writer('/needle/shape', ros.Shape)

    def poll(self):
        for message in self.commands.take(10):
            if hasattr(message, 'data'):  # Else a writer has left.
                self.arm.hear(message.data)
        for message in self.frames.take(10):
            for one in getattr(message, 'transforms', []):
                t, r = one.transform.translation, one.transform.rotation
                self.tracker.hear(one.child_frame_id, (t.x, t.y, t.z), (r.x, r.y, r.z, r.w))

    def joints(self, names, positions, rates):
        self.states.write(ros.JointState(header(), names, positions, rates, []))

    def shape(self, number, points, tip, axis):
        seen = [ros.SensedPoint(ros.Point(*point), ur_robot.SIGMA) for point in points]
        covariance = [ur_robot.SIGMA ** 2 if k % 4 == 0 else 0.0 for k in range(9)]
        end = ros.SensedTip(ros.Point(*tip), covariance, ros.Vector3(*axis), ur_robot.SIGMA_AXIS)
        self.shapes.write(ros.Shape(header('left_camera_optical_frame'), number, seen, end))


ur_robot.run(Network)
