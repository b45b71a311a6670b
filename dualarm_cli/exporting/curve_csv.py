"""CSV of a curve's points and frames."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.rotations import to_quaternion
from dualarm_cli.model.curves.discretisation import Points

HEADER = "s,x,y,z,qx,qy,qz,qw"


def curve_csv(s: FloatArray, points: Points) -> bytes:
    """Returns the CSV: length, position, unit quaternion in the part's frame; m.

    A task's `curve: {kind: poses, file: …}` takes it. Numbers are written so that reading them gives the same double;
    neighbouring quaternions are on the same side, so that a reader may interpolate between them.

    Args:
        s: lengths along the curve [m], shape (k,).
        points: its points.
    """
    quaternion = to_quaternion(points.R)
    # q and -q are one rotation: each is taken on the side of the one before.
    away = (quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0.0
    quaternion[1:][np.cumsum(away) % 2 == 1] *= -1.0
    # Adding zero turns -0.0 into 0.0.
    rows = (np.column_stack([s, points.p, quaternion]) + 0.0).tolist()
    return "\n".join([HEADER, *(",".join(map(repr, row)) for row in rows)]).encode() + b"\n"
