"""The points of a study: full grids over steps, samples over ranges without steps."""

from __future__ import annotations

from itertools import product

import numpy as np

from dualarm_cli.errors import UsageError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.study import Point, Sampling, Study

MOST_POINTS = 100_000
"""Most points of one study."""


def count_points(study: Study) -> int | None:
    """Returns how many points a study has; None where a range has neither steps nor samples."""
    sampled = any(parameter.span is not None for parameter in study.parameters)
    if sampled and study.sampling is None:
        return None
    count = study.sampling.count if sampled and study.sampling is not None else 1
    for parameter in study.parameters:
        count *= max(1, len(parameter.levels))
    return count


def study_points(study: Study) -> list[Point]:
    """Returns every combination of values: samples of the ranges, each with all steps of the others.

    Points go in the order of the parameters, the last one changing first; samples change first of all.

    Args:
        study: what is varied.

    Raises:
        UsageError: a range has neither steps nor samples, or there are too many points.
    """
    count = count_points(study)
    if count is None:
        parameter = next(p for p in study.parameters if p.span is not None)
        raise UsageError(
            f"{parameter.place}: the range of {parameter.name!r} has no steps; give it step or count, add "
            "`sample: {count: 40}` to the study, or search it with --optimise"
        )
    if count > MOST_POINTS:
        raise UsageError(
            f"{study.name}: makes {count:,} plans; at most {MOST_POINTS:,}: use longer steps, `sample:`, or --optimise"
        )
    spans = [p.span for p in study.parameters if p.span is not None]
    samples: list[Point] = [()]
    if study.sampling is not None:
        shares = sample_shares(study.sampling, len(spans))
        samples = [
            tuple(span.at(float(share)) for span, share in zip(spans, row, strict=True))
            for row in shares
        ]
    points = []
    for steps in product(*(p.levels for p in study.parameters if p.span is None)):
        for sample in samples:
            level, drawn = iter(steps), iter(sample)
            points.append(
                tuple(next(level) if p.span is None else next(drawn) for p in study.parameters)
            )
    return points


def sample_shares(sampling: Sampling, dimensions: int) -> FloatArray:
    """Returns samples of the unit cube, shape (count, dimensions).

    Args:
        sampling: how. Of a Latin hypercube each of `count` equal parts of every side has one sample. The first points
            of a longer Halton sequence are those of a shorter one.
        dimensions: of the cube.
    """
    from scipy.stats import qmc  # takes a second, and grids do without

    rng = np.random.default_rng(sampling.seed)
    if sampling.method == "halton":
        return qmc.Halton(dimensions, rng=rng).random(sampling.count)
    return qmc.LatinHypercube(dimensions, rng=rng).random(sampling.count)
