"""`ur_robot.py` on ROS 1, by rospy; see there."""
import rospy
from geometry_msgs.msg import Point, Vector3
from needle_steer_msgs.msg import SensedPoint, SensedTip, Shape
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from tf2_msgs.msg import TFMessage

import ur_robot


class Network:
    def __init__(self, arm, tracker):
        rospy.init_node('ur_hardware_interface', disable_signals=True)
        self.states = rospy.Publisher('joint_states', JointState, queue_size=1)
        self.shapes = rospy.Publisher('needle/shape', Shape, queue_size=1)
        rospy.Subscriber('joint_group_vel_controller/command', Float64MultiArray,
                         lambda message: arm.hear(message.data), queue_size=1, tcp_nodelay=True)
        rospy.Subscriber('/tf_static', TFMessage, lambda message: self.place(tracker, message))

    @staticmethod
    def place(tracker, message):
        for one in message.transforms:
            t, r = one.transform.translation, one.transform.rotation
            tracker.hear(one.child_frame_id, (t.x, t.y, t.z), (r.x, r.y, r.z, r.w))

    def poll(self):
        """rospy has threads of its own."""

    def joints(self, names, positions, rates):
        message = JointState(name=names, position=positions, velocity=rates)
        message.header.stamp = rospy.Time.now()
        self.states.publish(message)

    def shape(self, number, points, tip, axis):
        message = Shape(sequence=number)
        message.header.stamp = rospy.Time.now()
        message.header.frame_id = 'left_camera_optical_frame'
        message.points = [SensedPoint(Point(*point), ur_robot.SIGMA) for point in points]
        covariance = [ur_robot.SIGMA ** 2 if k % 4 == 0 else 0.0 for k in range(9)]
        message.tip = SensedTip(Point(*tip), covariance, Vector3(*axis), ur_robot.SIGMA_AXIS)
        self.shapes.publish(message)


ur_robot.run(Network)
