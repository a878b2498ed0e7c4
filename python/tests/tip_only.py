"""A copy of the law ``tip-only`` in Python: sliding mode and duty cycling with the default settings.

The arithmetic is in the built-in law's order: encoders round, and a last bit becomes a tick of them.
The insertion is straight; the bevel is turned towards the target (eq. 15), and where the needle
would curve too much, it spins for a part of each cycle (eqs. 21 to 24).
"""

import math

import numpy as np

TAU = 2.0 * math.pi
# Travel with which a spinning phase goes to and fro where there is none for a turn [rad].
SWEEP = 5.0
# Noise of the direction from which on the tangent is low-passed [rad].
NOISY = math.radians(0.3)


def wrap(angle):
    """An angle in (-pi, pi]."""
    turns = math.fmod(angle + math.pi, TAU)
    turns = (turns + TAU if turns < 0.0 else turns) - math.pi
    return math.pi if turns <= -math.pi else turns


def sign(x):
    return math.copysign(1.0, x)


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def unit(a):
    return a / math.sqrt(dot(a, a))


def turned(vector, a, b):
    """The vector, turned by the smallest rotation that takes direction ``a`` to ``b``."""
    a, b = unit(a), unit(b)
    axis = np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )
    if dot(axis, axis) <= np.finfo(float).eps ** 2:
        return vector
    x, y, z = unit(axis)
    angle = math.acos(dot(a, b))
    s, c = math.sin(angle), math.cos(angle)
    rest = 1.0 - c
    rows = [
        [x * x + (1.0 - x * x) * c, x * y * rest - z * s, x * z * rest + y * s],
        [x * y * rest + z * s, y * y + (1.0 - y * y) * c, y * z * rest - x * s],
        [x * z * rest - y * s, y * z * rest + x * s, z * z + (1.0 - z * z) * c],
    ]
    return np.array([dot(row, vector) for row in rows])


class Travel:
    def __init__(self, view):
        self.negative, self.positive = view.roll_travel

    def allows(self, angle):
        return angle <= self.positive if angle >= 0.0 else -angle <= self.negative

    def end_next_to(self, wish):
        ends = (self.positive, -self.negative)
        return min(ends, key=lambda end: abs(wrap(wish - end)))


class Cycle:
    """A duty cycle in progress."""

    def __init__(self, duty, length, turns):
        self.turns, self.turn, self.turned, self.advanced = turns, 0, 0.0, 0.0
        self.spin_length, self.insert_length = duty * length, (1.0 - duty) * length

    @classmethod
    def plan(cls, duty, length, sigma, sense, travel):
        for s in (sense, -sense):
            turn = s * TAU - wrap(sigma)
            if travel.allows(turn):
                return cls(duty, length, [turn, 0.0, 0.0])
        if travel.positive + travel.negative < SWEEP:
            return None
        ends = (travel.positive, -travel.negative)
        near, far = ends if travel.positive < travel.negative else ends[::-1]
        wish = wrap(-sigma)
        ways = [w for w in (wish, wish - sign(wish) * TAU) if travel.allows(w)]
        last = ways[0] if ways else travel.end_next_to(wish)
        return cls(duty, length, [near, far - near, last - far])

    def spun(self):
        rest = enumerate(self.turns[self.turn :], self.turn)
        return all(abs(t - (self.turned if k == self.turn else 0.0)) < 1e-6 for k, t in rest)

    def done(self):
        return self.spun() and self.advanced >= self.insert_length - 1e-9

    def advance(self, speed, omega, dt):
        """Speed of insertion [m/s] and spin [rad/s] for the next ``dt`` [s]."""
        if dt <= 0.0 or speed <= 0.0 or omega <= 0.0:
            return 0.0, 0.0
        if self.spun():
            step = min(max(self.insert_length - self.advanced, 0.0), speed * dt)
            self.advanced += step
            return step / dt, 0.0
        whole = sum(abs(turn) for turn in self.turns)
        duration = max(whole / omega, self.spin_length / speed)
        if abs(self.turns[self.turn] - self.turned) < 1e-6:
            self.turn, self.turned = self.turn + 1, 0.0
        left = self.turns[self.turn] - self.turned
        step = sign(left) * min(abs(left), whole / duration * dt)
        self.turned += step
        return self.spin_length * (abs(step) / whole) / dt, step / dt


class TipOnly:
    name = "tip-only in Python"

    def __init__(self, settings):
        """``settings`` is the table ``law.paper`` of a configuration."""
        self.settings = settings
        self.reset()

    def reset(self):
        self.cycle, self.duty_cycling, self.sense = None, False, 1.0
        self.detour, self.filtered = None, None

    def heading(self, view):
        """The target in the tip's frame, the tangent low-passed where it is noisy."""
        time = self.settings["tangent_filter_s"]
        if time <= 0.0 or view.tip_direction_sigma < NOISY:
            self.filtered = None
            return view.target_in_tip
        tip = view.tip
        axis = view.tip_axis
        gain = min(max(view.dt / time, 0.0), 1.0)
        old = self.filtered
        smooth = unit(axis if old is None else old + (axis - old) * gain)
        self.filtered = smooth
        return view.to_tip(turned(view.target - tip[:3, 3], smooth, axis))

    def decide(self, view):
        s = self.settings
        length, speed = s["cycle_length_mm"] * 1e-3, view.insertion_speed
        seen = self.heading(view)
        x, y, z = (float(v) for v in seen * (speed / math.sqrt(dot(seen, seen))))
        natural = min(max(view.natural_curvature, 0.3), 6.0)
        sigma = wrap(-0.5 * math.pi - math.atan2(y, x) + view.bevel_azimuth)
        # `abs` is C's hypot, as the built-in law has it; math.hypot rounds otherwise.
        heading = math.atan2(abs(complex(x, y)), z)
        omega = math.radians(min(s["omega_z_max_deg_s"], view.limits["spin_speed_deg_s"]))
        travel = Travel(view)
        threshold = natural * length
        if self.cycle is None or self.cycle.done():
            limit = 1.5 * threshold if self.duty_cycling else threshold
            self.duty_cycling = heading < limit
            self.cycle = None
            if self.duty_cycling:
                duty = min(max(1.0 - heading / length / natural, 0.0), 1.0)
                self.cycle = Cycle.plan(duty, length, sigma, self.sense, travel)
                if self.cycle is not None:
                    self.sense = -sign(self.cycle.turns[0])
        if self.cycle is not None:
            return view.screw(*self.cycle.advance(speed, omega, view.dt))
        held = math.sqrt(x * x + y * y) < math.sqrt(dot([x, y, z], [x, y, z])) * (
            view.tip_direction_sigma
        )
        return view.screw(speed, 0.0 if held else self.spin(sigma, omega, travel))

    def spin(self, sigma, omega, travel):
        """Eq. (15), the long way round where the travel does not allow the short one."""

        def slide(sigma):
            if abs(sigma) >= 0.25 * math.pi:
                return -sign(sigma) * omega
            return -4.0 / math.pi * sigma * omega

        short = -wrap(sigma)
        long = short - sign(short) * TAU
        if self.detour is not None:
            way = short if short * self.detour > 0.0 else long
            if abs(short) < 0.1 or not travel.allows(way):
                self.detour = None
        if self.detour is None and not travel.allows(short) and travel.allows(long):
            self.detour = sign(long)
        if self.detour is not None:
            return self.detour * omega
        if not travel.allows(short) and not travel.allows(long):
            return slide(-travel.end_next_to(short))
        return slide(wrap(sigma))
