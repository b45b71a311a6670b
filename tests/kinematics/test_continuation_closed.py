"""Lines of arms with closed forms: the same joints as Newton's continuation finds without them."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from dualarm_cli.kinematics.closed_arm import ClosedArm
from dualarm_cli.kinematics.continuation import FlangeLines
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.parallel_arm import ParallelArm
from dualarm_cli.kinematics.wrist_arm import WristArm


def arms(wrist_arms) -> dict[str, ClosedArm]:
    """A UR5, arms of random parallel axes, and arms with spherical wrists."""
    rng = np.random.default_rng(5)
    return {
        "ur5": ParallelArm.of(wrist_arms.dh_arm(wrist_arms.UR5).arm),
        "apart": ParallelArm.of(wrist_arms.random_parallel_arm(rng, False, True).arm),
        "heavy": WristArm.of(wrist_arms.dh_arm(wrist_arms.HEAVY).arm),
        "any": WristArm.of(wrist_arms.random_arm("any", rng, orthogonal=True).arm),
    }


@pytest.mark.parametrize("samples", [3, 7, 65])
@pytest.mark.parametrize("name", ["ur5", "apart", "heavy", "any"])
def test_lines_are_those_of_continuation_without_closed_forms(wrist_arms, name, samples):
    """200 lines of 80 mm from random postures; nearly the same of them can be followed."""
    closed = arms(wrist_arms)[name]
    general = GeneralArm(*(getattr(closed, field.name) for field in fields(GeneralArm)))
    rng = np.random.default_rng(9)
    q = rng.uniform(-2.8, 2.8, (200, 6))
    R, p = closed.forward(q)
    shift = rng.normal(size=(200, 3))
    shift *= 0.08 / np.linalg.norm(shift, axis=1, keepdims=True)
    lines = FlangeLines(R, p, shift)
    ours = closed.follow_lines(q, lines, np.zeros(200), samples)
    theirs = general.follow_lines(q, lines, np.zeros(200), samples)
    both = ours.ok & theirs.ok
    assert both.sum() >= 0.9 * theirs.ok.sum()
    assert theirs.ok.sum() > 80
    assert np.abs(ours.q - theirs.q)[:, both].max() < 1e-6
    # By forward kinematics: every sample of every line that is followed is on it.
    shares = np.linspace(0.0, 1.0, samples)[:, None, None]
    R_now, p_now = closed.forward(ours.q[:, ours.ok])
    assert np.abs(p_now - (p + shares * shift)[:, ours.ok]).max() < 1e-9
    assert np.abs(R_now - R[ours.ok]).max() < 1e-9
    assert (np.abs(np.diff(ours.q[:, ours.ok], axis=0)) < 0.7 + 1e-9).all()
