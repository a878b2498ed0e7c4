"""An arm under ros2_control on Cyclone DDS, written from docs/ROS.md and ROS 2's interface definitions:
a velocity controller that holds the last velocities that it heard for ever, and joint states at 125 Hz.

Arguments: topic of the velocities; names of the joints, comma-separated; where they stand [rad]. Lines on
standard input change it:
  creep RATE     joint 1 moves by itself [rad/s]
  skew SECONDS   added to the stamps of joint_states
  where          says "at Q..." [rad]
Says "ready", "moving" and "still" on standard output, with how long ago a velocity came that was not
zero [s].
"""
import sys
import threading
import time

import ros2_types as ros

topic, names, start = sys.argv[1], sys.argv[2].split(','), sys.argv[3].split(',')
position = [float(q) for q in start]
state = {'rates': [0.0] * len(position), 'creep': 0.0, 'skew': 0.0, 'moving': False}
heard = {'nonzero': 0.0}
node = ros.Node()
# As forward_command_controller's: reliable, the newest counts.
commands = node.reader(topic, ros.Float64MultiArray, depth=1)
joints = node.writer('/joint_states', ros.JointState)


def listen():
    for line in sys.stdin:
        words = line.split()
        if words[0] == 'where':
            print('at ' + ' '.join(repr(q) for q in position), flush=True)
        else:
            state[words[0]] = float(words[1])
            print('done', flush=True)


threading.Thread(target=listen, daemon=True).start()
print('ready', flush=True)
last = time.monotonic()
while True:
    time.sleep(0.008)
    now = time.monotonic()
    for message in commands.take(10):
        if not hasattr(message, 'data') or len(message.data) != len(position):
            continue
        moving = any(rate != 0.0 for rate in message.data)
        if moving:
            heard['nonzero'] = now
        state['rates'] = list(message.data)
        if moving != state['moving']:
            state['moving'] = moving
            print('%s %.4f' % ('moving' if moving else 'still', now - heard['nonzero']), flush=True)
    step, last = now - last, now
    for i, rate in enumerate(state['rates']):
        position[i] += step * rate
    position[0] += step * state['creep']
    stamp = time.time_ns() + int(state['skew'] * 1e9)
    joints.write(ros.JointState(ros.Header(ros.Time(stamp // 10**9, stamp % 10**9)), names,
                                list(position), list(state['rates']), []))
