"""An arm under ros_control: holds the last velocities that it heard, for ever.

Arguments: start joints [rad], comma-separated; folder of the message definitions. Lines on standard input change it:
  creep RATE     joint 1 moves by itself [rad/s]
  skew SECONDS   added to the stamps of joint_states
  status FIELD VALUE   of robot_status (a TriState; published once set)
Says "ready", "moving" and "still" on standard output, with the time and how long ago the last
velocity came.
"""
import sys
import threading
import time

import genpy.dynamic
import rospy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray



def definition(folder, name, others):
    """A message class from its definition: Debian does not package industrial_msgs."""
    def text(name):
        package, message = name.split('/')
        with open('%s/%s/msg/%s.msg' % (folder, package, message)) as file:
            return file.read()
    parts = [text(name)] + ['MSG: %s\n%s' % (other, text(other)) for other in others]
    return genpy.dynamic.generate_dynamic(name, ('\n' + '=' * 80 + '\n').join(parts))[name]


RobotStatus = definition(sys.argv[2], 'industrial_msgs/RobotStatus',
                         ['std_msgs/Header', 'industrial_msgs/RobotMode',
                          'industrial_msgs/TriState'])
position = [float(q) for q in sys.argv[1].split(',')]
names = ['joint_%d' % (i + 1) for i in range(len(position))]
state = {'rates': [0.0] * len(position), 'creep': 0.0, 'skew': 0.0, 'status': {}, 'moving': False}
heard = {'nonzero': 0.0}


def take(message):
    now = time.monotonic()
    moving = any(rate != 0.0 for rate in message.data)
    if moving:
        heard['nonzero'] = now
    state['rates'] = list(message.data)
    if moving != state['moving']:
        state['moving'] = moving
        word = 'moving' if moving else 'still'
        print('%s %.4f' % (word, now - heard['nonzero']), flush=True)


def listen():
    for line in sys.stdin:
        words = line.split()
        if words[0] == 'status':
            state['status'][words[1]] = int(words[2])
        else:
            state[words[0]] = float(words[1])
        print('done', flush=True)


rospy.init_node('arm', disable_signals=True)
joints = rospy.Publisher('joint_states', JointState, queue_size=1)
rospy.Subscriber('joint_group_velocity_controller/command', Float64MultiArray, take, queue_size=1,
                 tcp_nodelay=True)
status = None
threading.Thread(target=listen, daemon=True).start()
print('ready', flush=True)
last = time.monotonic()
while True:
    time.sleep(0.008)
    now = time.monotonic()
    step, last = now - last, now
    for i, rate in enumerate(state['rates']):
        position[i] += step * rate
    position[0] += step * state['creep']
    message = JointState()
    message.header.stamp = rospy.Time.from_sec(time.time() + state['skew'])
    message.name = names
    message.position = list(position)
    joints.publish(message)
    if state['status']:
        status = status or rospy.Publisher('robot_status', RobotStatus, queue_size=1)
        report = RobotStatus()
        for field in ('e_stopped', 'drives_powered', 'motion_possible', 'in_motion', 'in_error'):
            getattr(report, field).val = state['status'].get(field, -1)
        status.publish(report)
