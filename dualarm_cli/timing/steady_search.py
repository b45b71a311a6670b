"""Steady speeds and ramps along a joint path: the requested speed, or the largest feasible."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.geometry.elementary import cube, geometric, power
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class PathRates:
    """Joint derivatives by path progress at equidistant points."""

    first: FloatArray
    """First derivative q' [rad], shape (k, n)."""
    second: FloatArray
    """Second derivative q'' [rad], shape (k, n)."""
    third: FloatArray
    """Third derivative q''' [rad], shape (k, n)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("first", "second", "third"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    def backwards(self) -> PathRates:
        """Reverse the path."""
        return PathRates(-self.first[::-1], self.second[::-1], -self.third[::-1])

    def at(self, progress: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Interpolate the derivatives linearly at progress (...,), each (..., n)."""
        last = len(self.first) - 1
        position = np.clip(progress, 0.0, 1.0) * last
        k = np.minimum(position.astype(np.int64), last - 1)
        x = (position - k)[..., None]
        return (
            self.first[k] * (1.0 - x) + self.first[k + 1] * x,
            self.second[k] * (1.0 - x) + self.second[k + 1] * x,
            self.third[k] * (1.0 - x) + self.third[k + 1] * x,
        )


@dataclass(frozen=True)
class Ramp:
    """Ramp from rest to a speed, symmetric; reversed at the other end."""

    time: float
    """Duration [s]."""
    jerk_time: float
    """Duration of rising, and of falling, acceleration [s]; 0 for a trapezoid."""


@dataclass(frozen=True)
class SteadyProfile:
    """Progress along a path: a ramp, a steady speed, a ramp."""

    speed: float
    """Steady speed [1/s]."""
    start: Ramp
    """Ramp from rest."""
    end: Ramp
    """Ramp to rest."""

    @property
    def duration(self) -> float:
        """Duration [s]; a ramp covers half of its time's distance at full speed."""
        return 1.0 / self.speed + (self.start.time + self.end.time) / 2.0

    def edges(self) -> FloatArray:
        """Compute the borders of phases, from 0 to the duration [s], shape (8,)."""
        a, b, T = self.start, self.end, self.duration
        borders: FloatArray = np.array(
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
        return borders

    def at(self, time: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Evaluate progress, speed [1/s] and acceleration [1/s²] at times (k,) [s]."""
        first = ramp_at(np.minimum(time, self.start.time), self.speed, self.start)
        last = ramp_at(np.minimum(self.duration - time, self.end.time), self.speed, self.end)
        steady = np.clip(
            time - self.start.time, 0.0, self.duration - self.start.time - self.end.time
        )
        covered = self.speed * self.end.time / 2.0
        progress = first[0] + self.speed * steady + np.maximum(covered - last[0], 0.0)
        ending = time > self.duration - self.end.time
        speed = np.where(ending, last[1], first[1])
        acceleration = np.where(ending, -last[2], np.where(time < self.start.time, first[2], 0.0))
        return np.clip(progress, 0.0, 1.0), speed, acceleration


def ramp_at(
    time: FloatArray, speed: float, ramp: Ramp
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evaluate progress, speed and acceleration at times in a ramp from rest.

    With the acceleration a = v / (T - x) reached in x: a t²/2 x while it rises, then steady, then mirrored. After the
    ramp progress is constant.
    """
    T, x = ramp.time, ramp.jerk_time
    a = speed / (T - x)
    t = np.clip(time, 0.0, T)
    remaining = T - t
    safe = np.where(np.asarray(x) > 0.0, x, 1.0)
    rising, falling = t < x, remaining < x
    first = a * cube(t) / (6.0 * safe)
    middle = a * (np.square(t) / 2.0 - x * t / 2.0 + np.square(x) / 6.0)
    last = speed * T / 2.0 - speed * remaining + a * cube(remaining) / (6.0 * safe)
    progress = np.where(rising, first, np.where(falling, last, middle))
    speeds = np.where(
        rising,
        a * np.square(t) / (2.0 * safe),
        np.where(falling, speed - a * np.square(remaining) / (2.0 * safe), a * (t - x / 2.0)),
    )
    accelerations = np.where(rising, a * t / safe, np.where(falling, a * remaining / safe, a))
    return progress, speeds, accelerations


RATE_MARGIN = np.array([0.995, 0.985, 0.96])
"""Used fraction of velocity, acceleration and jerk limits.

The rest is for the spline of the motion.
"""
RAMPS = geometric(0.01, 2000.0, 116)
"""Ramp times that are tried, in geometric steps of a ninth [s]."""
RATIO = float(RAMPS[1] / RAMPS[0])


@dataclass(frozen=True)
class ProfileSettings:
    """Resolution of the search for steady profiles."""

    batch: int = 16
    """Number of ramp times per batch."""
    finer: int = 18
    """Number of finer ramp times below the first feasible one.

    They span the last two steps of `RAMPS` before it.
    """
    per_phase: int = 9
    """Number of instants per phase of a ramp in the first check."""
    close: int = 49
    """Number of instants per phase of a ramp in the final check.

    Only ramps that pass the first check have one.
    """
    at_once: int = 4
    """Number of ramps per batch of the final check."""
    speeds: int = 40
    """Number of speeds in the first grid where the speed has to be chosen."""
    near_best: int = 16
    """Number of speeds that are tried about the best of the first grid."""
    least_speed: float = 1e-3
    """Least speed of the first grid, as a share of the largest possible one.

    Short seams are over before they are
    fast."""
    as_fast: float = 1.0 + 1e-12
    """Rounding tolerance of comparisons of speeds and accelerations [factor]."""


PROFILE = ProfileSettings()

JERK_SHARES = np.array([0.5, 0.3, 0.15])
"""Fractions of a ramp with rising, and with falling, acceleration that are tried."""
FINER_SHARES = np.array([0.5, 0.44, 0.38, 0.32, 0.26, 0.2, 0.15, 0.1])
"""Fractions that are tried next to a ramp that is nearly the shortest."""
SHARES_OF_TIME = np.array([0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5])
"""Ramp times that are tried for a given duration, as fractions of it."""


@dataclass(frozen=True)
class TooFast:
    """Limiting joint, kind of limit and place of a speed limit along a path."""

    joint: str
    """Limiting joint."""
    kind: str
    """Kind of limit: velocity, acceleration or jerk."""
    share: float
    """Progress along the path at which the limit is reached."""
    speed: float
    """Largest feasible steady speed [1/s]."""


def steady_limit(rates: PathRates, limits: JointLimits) -> TooFast:
    """Find the largest steady speed along the path, and what limits it."""
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
    max_speed: float,
    acceleration: float | None = None,
    *,
    trapezoid: bool = False,
) -> SteadyProfile | None:
    """Find the fastest profile up to a steady speed; None if infeasible.

    A feasible steady speed gets the shortest feasible ramps. If the speed must be reduced, the one with the shortest
    total time is chosen. The method is ours.

    Args:
        rates: derivatives of the path.
        limits: limits of its joints.
        max_speed: largest steady speed [1/s].
        acceleration: largest acceleration of the progress [1/s²], or None.
        trapezoid: whether accelerations may jump; only for joints without jerk limits.
    """
    ramps = _Ramps(rates, limits, acceleration, trapezoid)
    top = steady_limit(rates, limits).speed
    if max_speed <= top:
        exact = ramps.quickest(np.array([max_speed]))
        if exact is not None:
            return ramps.shortened(exact)
    # Two ramps together cover at most the whole path.
    # Rounding may not make a ramp to the highest speed too fast.
    highest = min(max_speed, top / PROFILE.as_fast, 1.0 / RAMPS[0])
    speeds = highest * geometric(1.0, PROFILE.least_speed, PROFILE.speeds)
    best = ramps.quickest(speeds)
    if best is None:
        return None
    k = int(np.argmin(np.abs(speeds - best.speed)))
    finer = np.linspace(
        speeds[max(k - 1, 0)], speeds[min(k + 1, PROFILE.speeds - 1)], PROFILE.near_best
    )
    nearby = ramps.quickest(finer)
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
    """Find a profile of given duration, with short feasible ramps; None if too short.

    Args:
        rates: derivatives of the path.
        limits: limits of its joints.
        duration: of the whole motion, ramps included [s].
        acceleration: largest acceleration of the progress [1/s²], or None.
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
                end_ramp = Ramp(ramp, ramp * shape)
                return SteadyProfile(speed, end_ramp, end_ramp)
    fastest = fastest_profile(rates, limits, np.inf, acceleration, trapezoid=trapezoid)
    if fastest is None or fastest.duration > duration:
        return None
    # Stretching in time reduces every rate.
    factor = duration / fastest.duration
    start, end = (Ramp(r.time * factor, r.jerk_time * factor) for r in (fastest.start, fastest.end))
    return SteadyProfile(fastest.speed / factor, start, end)


@dataclass(frozen=True)
class _Ramps:
    """Feasible ramps at both ends of a path."""

    rates: PathRates
    """Rates of the path, which begins at rest."""
    limits: JointLimits
    """Limits of its joints."""
    acceleration: float | None
    """Largest acceleration of the progress [1/s²], or None."""
    trapezoid: bool
    """Whether accelerations may jump; only for joints without jerk limits."""

    @property
    def ends(self) -> tuple[_Ramps, _Ramps]:
        """Ramps at the start and, along the reversed path, at the end."""
        return self, replace(self, rates=self.rates.backwards())

    def quickest(self, speeds: FloatArray) -> SteadyProfile | None:
        """Select the fastest profile among steady speeds, or None."""
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
            profile = SteadyProfile(speed, *ramps)
            if best is None or profile.duration < best.duration:
                best = profile
        return best

    def shortest(self, speed: float) -> Ramp | None:
        """Find the shortest feasible ramp to a speed, or None."""
        least = 0.0
        if self.acceleration is not None:
            least = speed / (self.acceleration * PROFILE.as_fast)
        times = RAMPS[(2.0 / speed >= RAMPS) & (least / RATIO < RAMPS)]
        for k in range(0, len(times), PROFILE.batch):
            feasible = self.first(speed, times[k : k + PROFILE.batch], JERK_SHARES)
            if feasible is not None:
                low = feasible.time / np.square(RATIO)
                shorter = geometric(low, feasible.time, PROFILE.finer + 1)[:-1]
                return self.first(speed, shorter, FINER_SHARES) or feasible
        return None

    def shortened(self, profile: SteadyProfile) -> SteadyProfile:
        """Shorten a profile's ramps by finer steps of time."""
        ramps = []
        for end, ramp in zip(self.ends, (profile.start, profile.end), strict=True):
            low = ramp.time / power(RATIO, 2.0 / PROFILE.finer)
            times = geometric(low, ramp.time, PROFILE.finer + 1)[:-1]
            ramps.append(end.first(profile.speed, times, FINER_SHARES) or ramp)
        return SteadyProfile(profile.speed, *ramps)

    def first(self, speed: float, times: FloatArray, shapes: FloatArray) -> Ramp | None:
        """Select the first feasible ramp, or None.

        The candidates are all times (g,) [s] in their order, each with all shapes (h,).
        """
        shapes = np.zeros(1) if self.trapezoid else shapes
        time, shape = (grid.ravel() for grid in np.meshgrid(times, shapes, indexing="ij"))
        candidates = np.flatnonzero(self.keep(speed, time, shape))
        # On a wavy path rates have peaks between the few instants of the first check.
        for k in range(0, len(candidates), PROFILE.at_once):
            batch = candidates[k : k + PROFILE.at_once]
            feasible = batch[self.keep(speed, time[batch], shape[batch], PROFILE.close)]
            if len(feasible):
                return Ramp(float(time[feasible[0]]), float((time * shape)[feasible[0]]))
        return None

    def keep(
        self,
        speed: float,
        time: FloatArray,
        shape: FloatArray,
        instants: int = PROFILE.per_phase,
    ) -> BoolArray:
        """Check which ramps to a speed keep every limit, shape (g,).

        Args:
            speed: steady speed [1/s].
            time: durations of the ramps [s], shape (g,).
            shape: fraction of each in which the acceleration rises, shape (g,).
            instants: number of instants per phase.
        """
        x = shape * time
        peak = speed / (time - x)
        edges = np.stack([np.zeros_like(time), x, time - x, time], axis=-1)
        inner = np.linspace(0.0, 1.0, instants)
        t = edges[:, :-1, None] + np.diff(edges, axis=1)[:, :, None] * inner
        ramp = Ramp(time[:, None, None], x[:, None, None])  # type: ignore[arg-type]
        s, sd, sdd = ramp_at(t, speed, ramp)
        sddd = np.zeros_like(s)
        with np.errstate(divide="ignore", invalid="ignore"):
            rise = np.where(x > 0.0, peak / np.where(x > 0.0, x, 1.0), 0.0)
        sddd[:, 0], sddd[:, 2] = rise[:, None], -rise[:, None]
        # Where the acceleration jumps, both limits are checked.
        sdd[:, 1] = peak[:, None]
        q1, q2, q3 = self.rates.at(s)
        sd, sdd, sddd = sd[..., None], sdd[..., None], sddd[..., None]
        velocity = np.abs(q1 * sd) / self.limits.velocity
        accelerations = np.abs(q2 * np.square(sd) + q1 * sdd) / self.limits.acceleration
        jerks = np.abs(q3 * cube(sd) + 3.0 * q2 * sd * sdd + q1 * sddd) / self.limits.jerk
        largest = [part.max(axis=(1, 2, 3)) for part in (velocity, accelerations, jerks)]
        feasible = np.all(
            [rate <= margin for rate, margin in zip(largest, RATE_MARGIN, strict=True)], axis=0
        )
        feasible &= s.max(axis=(1, 2)) <= PROFILE.as_fast
        if self.acceleration is not None:
            feasible &= peak <= self.acceleration * PROFILE.as_fast
        return np.asarray(feasible)
