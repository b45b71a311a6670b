"""Steady speeds and ramps along a joint path: as fast as asked, or as the joints allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.geometry.elementary import cube, geometric, power
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class PathRates:
    """What the joints do per unit of the share of a path, at equidistant places."""

    first: FloatArray
    """q' [rad], shape (k, n)."""
    second: FloatArray
    """q'' [rad], shape (k, n)."""
    third: FloatArray
    """q''' [rad], shape (k, n)."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("first", "second", "third"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    def backwards(self) -> PathRates:
        """Returns the same path from its end."""
        return PathRates(-self.first[::-1], self.second[::-1], -self.third[::-1])

    def at(self, share: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns them at shares (...,) of the path, linear between places, each (..., n)."""
        last = len(self.first) - 1
        place = np.clip(share, 0.0, 1.0) * last
        k = np.minimum(place.astype(np.int64), last - 1)
        x = (place - k)[..., None]
        return (
            self.first[k] * (1.0 - x) + self.first[k + 1] * x,
            self.second[k] * (1.0 - x) + self.second[k + 1] * x,
            self.third[k] * (1.0 - x) + self.third[k + 1] * x,
        )


@dataclass(frozen=True)
class Ramp:
    """From rest to a speed: acceleration up, steady, down, the mirror image at the other end."""

    time: float
    """How long it takes [s]."""
    jerk_time: float
    """How long the acceleration takes to rise, and to fall [s]; 0 for a trapezoid."""


@dataclass(frozen=True)
class SteadyProfile:
    """Share of a path over time: a ramp, a steady speed, a ramp."""

    speed: float
    """Steady speed [1/s]."""
    start: Ramp
    """From rest."""
    end: Ramp
    """To rest."""

    @property
    def duration(self) -> float:
        """How long it takes [s]: a ramp covers half of what its time would at full speed."""
        return 1.0 / self.speed + (self.start.time + self.end.time) / 2.0

    def edges(self) -> FloatArray:
        """Returns where phases meet, from 0 to the duration [s], shape (8,)."""
        a, b, T = self.start, self.end, self.duration
        found: FloatArray = np.array(
            [
                0.0,
                a.jerk_time,
                a.time - a.jerk_time,
                a.time,
                T - b.time,
                T - b.time + b.jerk_time,
                T - b.jerk_time,
                T,
            ]
        )
        return found

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns share, speed [1/s] and acceleration [1/s²] at instants (k,) [s]."""
        first = ramp_at(np.minimum(time, self.start.time), self.speed, self.start)
        last = ramp_at(np.minimum(self.duration - time, self.end.time), self.speed, self.end)
        steady = np.clip(
            time - self.start.time, 0.0, self.duration - self.start.time - self.end.time
        )
        covered = self.speed * self.end.time / 2.0
        share = first[0] + self.speed * steady + np.maximum(covered - last[0], 0.0)
        ending = time > self.duration - self.end.time
        speed = np.where(ending, last[1], first[1])
        acceleration = np.where(ending, -last[2], np.where(time < self.start.time, first[2], 0.0))
        return np.clip(share, 0.0, 1.0), speed, acceleration


def ramp_at(
    time: FloatArray, speed: float, ramp: Ramp
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns share, speed and acceleration after times in a ramp from rest; after its end nothing more is covered.

    With the acceleration a = v / (T - x) reached in x: a t²/2 x while it rises, then steady, then as at the start
    backwards.
    """
    T, x = ramp.time, ramp.jerk_time
    a = speed / (T - x)
    t = np.clip(time, 0.0, T)
    left = T - t
    safe = np.where(np.asarray(x) > 0.0, x, 1.0)
    rising, falling = t < x, left < x
    first = a * cube(t) / (6.0 * safe)
    middle = a * (np.square(t) / 2.0 - x * t / 2.0 + np.square(x) / 6.0)
    last = speed * T / 2.0 - speed * left + a * cube(left) / (6.0 * safe)
    share = np.where(rising, first, np.where(falling, last, middle))
    speeds = np.where(
        rising,
        a * np.square(t) / (2.0 * safe),
        np.where(falling, speed - a * np.square(left) / (2.0 * safe), a * (t - x / 2.0)),
    )
    accelerations = np.where(rising, a * t / safe, np.where(falling, a * left / safe, a))
    return share, speeds, accelerations


RATE_MARGIN = np.array([0.995, 0.985, 0.96])
"""Share of velocity, acceleration and jerk limits that is used: the motion's spline is a little dearer."""
RAMPS = geometric(0.01, 2000.0, 116)
"""Times of a ramp that are tried, each a ninth longer than the one before [s]."""
RATIO = float(RAMPS[1] / RAMPS[0])


@dataclass(frozen=True)
class ProfileSettings:
    """Resolution of the search for steady profiles."""

    together: int = 16
    """Number of ramp times that are tried at once."""
    finer: int = 18
    """Number of finer ramp times below the first feasible one. They span the last two steps of `RAMPS` before it."""
    per_phase: int = 9
    """Number of instants per phase of a ramp in the first check."""
    close: int = 49
    """Number of instants per phase of a ramp in the final check. Only ramps that pass the first check have one."""
    at_once: int = 4
    """Number of ramps per batch of the final check."""
    speeds: int = 40
    """Number of speeds in the first grid where the speed has to be chosen."""
    near_best: int = 16
    """Number of speeds that are tried about the best of the first grid."""
    least_speed: float = 1e-3
    """Least speed of the first grid, as a share of the largest possible one. Short seams are over before they are
    fast."""
    as_fast: float = 1.0 + 1e-12
    """Rounding tolerance of comparisons of speeds and accelerations [factor]."""


PROFILE = ProfileSettings()

JERK_SHARES = np.array([0.5, 0.3, 0.15])
"""Shares of a ramp in which the acceleration rises, and falls again, that are tried."""
FINER_SHARES = np.array([0.5, 0.44, 0.38, 0.32, 0.26, 0.2, 0.15, 0.1])
"""Those that are tried where a ramp is known that is nearly the shortest."""
SHARES_OF_TIME = np.array([0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5])
"""Ramps that are tried where the whole time is given, as shares of it."""


@dataclass(frozen=True)
class TooFast:
    """Why a speed cannot be kept."""

    joint: str
    """The joint that would have to be quicker."""
    kind: str
    """velocity, acceleration or jerk."""
    share: float
    """Where on the path."""
    speed: float
    """The largest steady speed that all joints allow [1/s]."""


def steady_limit(rates: PathRates, limits: JointLimits) -> TooFast:
    """Returns the largest steady speed along the whole path, with the joint and the place that decide."""
    names = ("velocity", "acceleration", "jerk")
    allowed = (limits.velocity, limits.acceleration, limits.jerk)
    slowness = [
        power(np.abs(rate) / (limit * margin), 1.0 / order)
        for order, (rate, limit, margin) in enumerate(
            zip((rates.first, rates.second, rates.third), allowed, RATE_MARGIN, strict=True), 1
        )
    ]
    stacked = np.stack(slowness)
    kind, place, joint = (int(i) for i in np.unravel_index(int(np.argmax(stacked)), stacked.shape))
    worst = float(stacked.max())
    share = place / (stacked.shape[1] - 1)
    return TooFast(limits.joints[joint], names[kind], share, 1.0 / max(worst, 1e-9))


def fastest_profile(
    rates: PathRates,
    limits: JointLimits,
    most: float,
    acceleration: float | None = None,
    *,
    trapezoid: bool = False,
) -> SteadyProfile | None:
    """Returns the quickest profile whose steady speed is no higher than asked, or None where none keeps the limits.

    A steady speed that the joints allow takes the shortest ramps that keep every limit; where the speed itself has to
    be chosen, the one of least total time is. Our own.

    Args:
        rates: of the path.
        limits: of its joints.
        most: largest steady speed [1/s].
        acceleration: largest acceleration of the share [1/s²], or None.
        trapezoid: whether accelerations may jump; only for joints without jerk limits.
    """
    ramps = _Ramps(rates, limits, acceleration, trapezoid)
    top = steady_limit(rates, limits).speed
    if most <= top:
        exact = ramps.quickest(np.array([most]))
        if exact is not None:
            return ramps.shortened(exact)
    # Two ramps cover the whole path at most.
    # Rounding may not make a ramp to the highest speed too fast.
    highest = min(most, top / PROFILE.as_fast, 1.0 / RAMPS[0])
    speeds = highest * geometric(1.0, PROFILE.least_speed, PROFILE.speeds)
    best = ramps.quickest(speeds)
    if best is None:
        return None
    k = int(np.argmin(np.abs(speeds - best.speed)))
    near = np.linspace(
        speeds[max(k - 1, 0)], speeds[min(k + 1, PROFILE.speeds - 1)], PROFILE.near_best
    )
    nearby = ramps.quickest(near)
    if nearby is not None and nearby.duration < best.duration:
        best = nearby
    return ramps.shortened(best)


def profile_of_duration(
    rates: PathRates,
    limits: JointLimits,
    duration: float,
    acceleration: float | None = None,
    *,
    trapezoid: bool = False,
) -> SteadyProfile | None:
    """Returns a profile of a given time, with the shortest ramps of some that keep all limits; None if it is too short.

    Args:
        rates: of the path.
        limits: of its joints.
        duration: of the whole motion, ramps included [s].
        acceleration: largest acceleration of the share [1/s²], or None.
        trapezoid: whether accelerations may jump; only for joints without jerk limits.
    """
    ends = _Ramps(rates, limits, acceleration, trapezoid).ends
    top = steady_limit(rates, limits).speed
    shapes = [0.0] if trapezoid else JERK_SHARES.tolist()
    for ramp in (duration * SHARES_OF_TIME).tolist():
        speed = 1.0 / (duration - ramp)
        if speed > top:
            continue
        for shape in shapes:
            time, part = np.array([ramp]), np.array([shape])
            if all(end.keep(speed, time, part, PROFILE.close).all() for end in ends):
                one = Ramp(ramp, ramp * shape)
                return SteadyProfile(speed, one, one)
    fastest = fastest_profile(rates, limits, np.inf, acceleration, trapezoid=trapezoid)
    if fastest is None or fastest.duration > duration:
        return None
    # Stretched in time, every rate is lower.
    longer = duration / fastest.duration
    start, end = (Ramp(r.time * longer, r.jerk_time * longer) for r in (fastest.start, fastest.end))
    return SteadyProfile(fastest.speed / longer, start, end)


@dataclass(frozen=True)
class _Ramps:
    """Ramps to both ends of a path that keep every limit."""

    rates: PathRates
    """Rates of the path, which begins at rest."""
    limits: JointLimits
    """Limits of its joints."""
    acceleration: float | None
    """Largest acceleration of the share [1/s²], or None."""
    trapezoid: bool
    """Flag of accelerations that may jump; only for joints without jerk limits."""

    @property
    def ends(self) -> tuple[_Ramps, _Ramps]:
        """The path from its start, and from its end."""
        return self, replace(self, rates=self.rates.backwards())

    def quickest(self, speeds: FloatArray) -> SteadyProfile | None:
        """Select the quickest profile of some steady speeds, or None."""
        best: SteadyProfile | None = None
        for speed in speeds.tolist():
            ramps = []
            for end in self.ends:
                ramp = end.shortest(speed)
                if ramp is None:
                    break
                ramps.append(ramp)
            if len(ramps) < 2 or speed * (ramps[0].time + ramps[1].time) / 2.0 > 1.0:
                continue
            found = SteadyProfile(speed, *ramps)
            if best is None or found.duration < best.duration:
                best = found
        return best

    def shortest(self, speed: float) -> Ramp | None:
        """Select the shortest ramp to a speed that keeps every limit, or None."""
        least = 0.0
        if self.acceleration is not None:
            least = speed / (self.acceleration * PROFILE.as_fast)
        times = RAMPS[(2.0 / speed >= RAMPS) & (least / RATIO < RAMPS)]
        for k in range(0, len(times), PROFILE.together):
            found = self.first(speed, times[k : k + PROFILE.together], JERK_SHARES)
            if found is not None:
                low = found.time / np.square(RATIO)
                shorter = geometric(low, found.time, PROFILE.finer + 1)[:-1]
                return self.first(speed, shorter, FINER_SHARES) or found
        return None

    def shortened(self, profile: SteadyProfile) -> SteadyProfile:
        """Shorten a profile's ramps by what the times that were tried leave between them."""
        ramps = []
        for end, ramp in zip(self.ends, (profile.start, profile.end), strict=True):
            low = ramp.time / power(RATIO, 2.0 / PROFILE.finer)
            times = geometric(low, ramp.time, PROFILE.finer + 1)[:-1]
            ramps.append(end.first(profile.speed, times, FINER_SHARES) or ramp)
        return SteadyProfile(profile.speed, *ramps)

    def first(self, speed: float, times: FloatArray, shapes: FloatArray) -> Ramp | None:
        """Select the first ramp that keeps every limit, or None.

        The candidates are all times (g,) [s] in their order, each with all shapes (h,).
        """
        shapes = np.zeros(1) if self.trapezoid else shapes
        time, shape = (grid.ravel() for grid in np.meshgrid(times, shapes, indexing="ij"))
        good = np.flatnonzero(self.keep(speed, time, shape))
        # On a wavy path rates have peaks between the few instants by which most ramps are refused.
        for k in range(0, len(good), PROFILE.at_once):
            some = good[k : k + PROFILE.at_once]
            kept = some[self.keep(speed, time[some], shape[some], PROFILE.close)]
            if len(kept):
                return Ramp(float(time[kept[0]]), float((time * shape)[kept[0]]))
        return None

    def keep(
        self,
        speed: float,
        time: FloatArray,
        shape: FloatArray,
        instants: int = PROFILE.per_phase,
    ) -> BoolArray:
        """Select the ramps to a speed that keep every limit, shape (g,).

        Args:
            speed: steady speed [1/s].
            time: of the ramps [s], shape (g,).
            shape: share of each in which the acceleration rises, shape (g,).
            instants: of each phase that are looked at.
        """
        x = shape * time
        steep = speed / (time - x)
        edges = np.stack([np.zeros_like(time), x, time - x, time], axis=-1)
        inner = np.linspace(0.0, 1.0, instants)
        t = edges[:, :-1, None] + np.diff(edges, axis=1)[:, :, None] * inner
        ramp = Ramp(time[:, None, None], x[:, None, None])  # type: ignore[arg-type]
        s, sd, sdd = ramp_at(t, speed, ramp)
        sddd = np.zeros_like(s)
        with np.errstate(divide="ignore", invalid="ignore"):
            rise = np.where(x > 0.0, steep / np.where(x > 0.0, x, 1.0), 0.0)
        sddd[:, 0], sddd[:, 2] = rise[:, None], -rise[:, None]
        # Where the acceleration jumps both sides count.
        sdd[:, 1] = steep[:, None]
        q1, q2, q3 = self.rates.at(s)
        sd, sdd, sddd = sd[..., None], sdd[..., None], sddd[..., None]
        velocity = np.abs(q1 * sd) / self.limits.velocity
        accelerations = np.abs(q2 * np.square(sd) + q1 * sdd) / self.limits.acceleration
        jerks = np.abs(q3 * cube(sd) + 3.0 * q2 * sd * sdd + q1 * sddd) / self.limits.jerk
        largest = [part.max(axis=(1, 2, 3)) for part in (velocity, accelerations, jerks)]
        good = np.all(
            [one <= margin for one, margin in zip(largest, RATE_MARGIN, strict=True)], axis=0
        )
        good &= s.max(axis=(1, 2)) <= PROFILE.as_fast
        if self.acceleration is not None:
            good &= steep <= self.acceleration * PROFILE.as_fast
        return np.asarray(good)
