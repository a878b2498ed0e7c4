"""A UR5 of another laboratory, with its needle, tissue and tracker, written from docs/ROS.md and the maker's published
figures alone. `ur_ros1.py` and `ur_ros2.py` put it on a network.

The arm has the maker's Denavit-Hartenberg parameters and joint names, reports its joints in the order of the
alphabet as its driver does, follows velocities with a bounded acceleration, and holds the last ones for ever. The
needle cuts along its bevel into tissue that holds its path; a tracker shows it on `needle/shape`, in the frame that
the program itself says on /tf_static where the left camera is.

Argument: start joints [rad], base to flange, comma-separated. Lines on standard input:
  where     says "tip X Y Z DX DY DZ": the needle's tip and direction in World [m]
Says "ready"; "depth MM" at every whole millimetre in the tissue; and "rest S" when the arm comes to rest, with how long
ago the last velocity came that was not zero [s].
"""
import math
import random
import sys
import threading
import time

# Base to flange.
JOINTS = ['shoulder_pan_joint', 'shoulder_lift_joint', 'elbow_joint', 'wrist_1_joint', 'wrist_2_joint',
          'wrist_3_joint']
REPORTED = sorted(range(6), key=lambda i: JOINTS[i])
# d [m], a [m], alpha [rad] of the UR5.
LINKS = [(0.089159, 0.0, math.pi / 2), (0.0, -0.425, 0.0), (0.0, -0.39225, 0.0),
         (0.10915, 0.0, math.pi / 2), (0.09465, 0.0, -math.pi / 2), (0.0823, 0.0, 0.0)]
ACCELERATION = 40.0  # rad/s2
RATE = 125.0  # Hz

# The needle that docs/CONFIG.md describes, and the tissue's surface [m].
LENGTH = 0.126
SURFACE = 0.25
CURVATURE = 2.0  # of its path [1/m]
FELT = 0.012  # depth over which the base's tilt is felt at the tip [m]

# The tracker: rate [Hz], points, deviations [m, rad].
FRAMES = 30.0
POINTS = 12
SIGMA, SIGMA_AXIS = 0.05e-3, 5e-3


def add(a, b, k=1.0):
    return [x + k * y for x, y in zip(a, b)]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def unit(a):
    return [x / math.sqrt(dot(a, a)) for x in a]


def times(a, b):
    """Of two frames: rows [axes | origin]."""
    product = [[dot(row[:3], [c[k] for c in b]) for k in range(4)] for row in a]
    for row, left in zip(product, a):
        row[3] += left[3]
    return product


def column(frame, k):
    return [row[k] for row in frame]


def inverse(frame):
    origin = column(frame, 3)
    return [[frame[k][i] for k in range(3)] + [-dot(column(frame, i), origin)] for i in range(3)]


def frame_of(translation, quaternion):
    x, y, z, w = quaternion
    t = translation
    return [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), t[0]],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), t[1]],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), t[2]]]


def flange(joints):
    """In ROS's base_link, which is turned by half a turn from the maker's base; so is tool0."""
    half = [[-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 1, 0]]
    frame = half
    for q, (d, a, alpha) in zip(joints, LINKS):
        c, s, ca, sa = math.cos(q), math.sin(q), math.cos(alpha), math.sin(alpha)
        frame = times(frame, [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d]])
    return times(frame, half)


class Needle:
    """Its path in the tissue; the tip goes where the bevel leads it, and with the base's tilt near the surface."""

    def __init__(self):
        self.path = []
        self.tip = self.direction = None
        self.depth = 0.0

    def move(self, base):
        origin, axis, bevel = column(base, 3), column(base, 2), [-x for x in column(base, 1)]
        if not self.path:
            tip = self.tip = add(origin, axis, LENGTH)
            self.direction = axis
            if tip[2] > SURFACE:
                return
            self.path = [add(tip, axis, (SURFACE - tip[2]) / axis[2])]
        way = add(self.path[0], origin, -1.0)
        advance = LENGTH - math.sqrt(dot(way, way)) - self.depth
        if advance > 0.1e-3:
            tilt = math.exp(-self.depth / FELT) / FELT
            turn = add([tilt * x for x in add(unit(way), self.direction, -1.0)], bevel, CURVATURE)
            self.direction = unit(add(self.direction, turn, advance))
            self.path.append(add(self.path[-1], self.direction, advance))
            self.depth += advance
        elif advance < -0.1e-3 and len(self.path) > 1:
            last = self.path.pop()
            back = add(last, self.path[-1], -1.0)
            self.depth -= math.sqrt(dot(back, back))
            self.direction = unit(back)
        self.tip = self.path[-1]


class Tracker:
    """What it shows of the needle: points and tip [m] and direction, in the left camera's frame."""

    def __init__(self):
        self.frames = {}

    def hear(self, name, translation, quaternion):
        self.frames[name] = frame_of(translation, quaternion)

    def base(self):
        """Where the arm's base stands."""
        return self.frames.get('base_link', [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]])

    def sees(self, needle):
        if 'left_camera_optical_frame' not in self.frames or needle.tip is None:
            return None
        camera = inverse(self.frames['left_camera_optical_frame'])

        def seen(point):
            here = [dot(row[:3], point) + row[3] for row in camera]
            return [x + random.gauss(0.0, SIGMA) for x in here]
        last = len(needle.path) - 1
        points = [seen(needle.path[k * last // (POINTS - 1)]) for k in range(POINTS) if last >= POINTS]
        axis = [dot(row[:3], needle.direction) for row in camera]
        axis = unit([x + random.gauss(0.0, SIGMA_AXIS) for x in axis])
        return points, seen(needle.tip), axis


class Arm:
    def __init__(self, joints):
        self.joints = joints
        self.rates = [0.0] * 6
        self.wanted = [0.0] * 6
        self.heard = 0.0
        self.moving = False

    def hear(self, velocities):
        if len(velocities) != 6:
            return
        self.wanted = list(velocities)
        if any(self.wanted):
            self.heard = time.monotonic()

    def step(self, dt):
        most = ACCELERATION * dt
        for i, wanted in enumerate(self.wanted):
            self.rates[i] += max(-most, min(most, wanted - self.rates[i]))
            self.joints[i] += dt * self.rates[i]
        moving = any(self.rates)
        if self.moving and not moving:
            print('rest %.4f' % (time.monotonic() - self.heard), flush=True)
        self.moving = moving

    def report(self):
        """Names, positions, rates."""
        return [[values[i] for i in REPORTED] for values in (JOINTS, self.joints, self.rates)]


def run(network):
    """For ever. `network(arm, tracker)` is called once; what it gives has `poll()`, `joints(names, positions,
    rates)` and `shape(number, points, tip, axis)`."""
    arm, needle, tracker = Arm([float(q) for q in sys.argv[1].split(',')]), Needle(), Tracker()
    network = network(arm, tracker)

    def listen():
        for line in sys.stdin:
            if line.strip() == 'where':
                print('tip ' + ' '.join(repr(x) for x in needle.tip + needle.direction), flush=True)
    threading.Thread(target=listen, daemon=True).start()
    print('ready', flush=True)
    last = shown = time.monotonic()
    said = number = 0
    while True:
        time.sleep(1.0 / RATE)
        network.poll()
        now = time.monotonic()
        arm.step(now - last)
        last = now
        network.joints(*arm.report())
        needle.move(times(tracker.base(), flange(arm.joints)))
        if now - shown >= 1.0 / FRAMES:
            shown = now
            seen = tracker.sees(needle)
            if seen:
                network.shape(number, *seen)
                number += 1
        if int(needle.depth * 1e3) > said:
            said = int(needle.depth * 1e3)
            print('depth %d' % said, flush=True)
