"""Six-axis arms of capsules for `branch_pairs.py`: kinematics, branches and distances of their own."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

Link = tuple[Any, ...]
"""Place in the parent, its rotation, both ends of a capsule and its radius [m, rad]."""
H = 0.5 * math.pi
UR = (
    ((0, 0, 0.15185), (0, 0, 0), (0, 0, -0.01), (0, 0, 0.01), 0.055),
    ((0, 0, 0), (H, 0, 0), (0, 0, 0.118), (-0.24355, 0, 0.118), 0.05),
    ((-0.24355, 0, 0), (0, 0, 0), (-0.03, 0, 0.0131), (-0.1832, 0, 0.0131), 0.04),
    ((-0.2132, 0, 0.13105), (0, 0, 0), (0, 0, -0.01), (0, 0, 0.01), 0.038),
    ((0, -0.08535, 0), (H, 0, 0), (0, 0, -0.01), (0, 0, 0.01), 0.038),
    ((0, 0.0921, 0), (H, math.pi, math.pi), (0, 0, -0.025), (0, 0, -0.015), 0.03),
)
"""UR3e: of each joint its place in the parent and rotation, of its link a capsule's ends and radius [m, rad]."""
WRIST = (
    ((0, 0, 0.1525), (0, 0, 0), (0, 0, -0.02), (0, 0, 0.02), 0.07),
    ((0, 0.0345, 0), (0, -H, -H), (0.02, 0, 0), (0.62, 0, 0), 0.06),
    ((0.62, 0, 0), (0, 0, H), (0, 0, 0), (0, -0.2, 0), 0.055),
    ((0, -0.559, 0), (H, 0, 0), (0, 0, -0.3), (0, 0, -0.02), 0.05),
    ((0, 0, 0), (-H, 0, 0), (0, 0, -0.01), (0, 0, 0.01), 0.05),
    ((0, -0.121, 0), (H, 0, 0), (0, 0, -0.03), (0, 0, -0.01), 0.035),
)
"""Doosan M1013, with capsules of our own: a spherical wrist."""
OFFSET = (*WRIST[:5], ((0.05, -0.121, 0), *WRIST[5][1:]))
"""The same with a last axis beside the wrist's centre."""
TOOL = ((0.0, 0.0, 0.01), (0.0, 0.0, 0.07), 0.02)
REACH = 0.1
"""Tool centre point beyond the flange [m]."""
KEPT = 0.004
"""Clearance that a plan found here keeps [m]: more than the planner's own margin."""


def rpy(r: float, p: float, y: float) -> np.ndarray:
    """Rotation of roll, pitch and yaw."""
    cr, sr, cp, sp, cy, sy = (f(v) for v in (r, p, y) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


@dataclass
class Arm:
    """One arm of a cell."""

    links: tuple[Link, ...]
    limit: np.ndarray
    R: np.ndarray
    p: np.ndarray

    def frames(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World frames of all links, (n, 6, 3, 3) and (n, 6, 3)."""
        R, p, Rs, ps = np.tile(self.R, (len(q), 1, 1)), np.tile(self.p, (len(q), 1)), [], []
        for k, (xyz, turn, *_) in enumerate(self.links):
            p = p + R @ np.array(xyz)
            c, s, o = np.cos(q[:, k]), np.sin(q[:, k]), np.zeros(len(q))
            z = np.stack([c, -s, o, s, c, o, o, o, o + 1], axis=1).reshape(-1, 3, 3)
            R = R @ rpy(*turn) @ z
            Rs.append(R)
            ps.append(p)
        return np.stack(Rs, 1), np.stack(ps, 1)

    def bodies(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Ends and radii of the base's, the links' and the tool's capsules, (n, 8, 3) twice and (8,)."""
        R, p = self.frames(q)
        rows = [(k, *link[2:]) for k, link in enumerate(self.links)] + [(5, *TOOL)]
        ends = [
            np.stack([p[:, k] + R[:, k] @ np.array(row[e]) for k, *row in rows], 1) for e in (0, 1)
        ]
        base = [self.p + self.R @ np.array([0, 0, z]) for z in (0.035, 0.065)]
        ends = [
            np.concatenate([np.tile(b, (len(q), 1, 1)), e], 1)
            for b, e in zip(base, ends, strict=True)
        ]
        return ends[0], ends[1], np.array([0.06, *(row[3] for row in rows)])

    def step(self, q: np.ndarray, R: np.ndarray, p: np.ndarray, most: float) -> np.ndarray:
        """Newton's steps towards tool poses, in place, at most so large; what is left (n,)."""
        Rs, ps = self.frames(q)
        tip = ps[:, 5] + Rs[:, 5] @ np.array([0, 0, REACH])
        D = R @ np.swapaxes(Rs[:, 5], 1, 2)
        vee = np.stack(
            [D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0], D[:, 1, 0] - D[:, 0, 1]], 1
        )
        angle = np.arccos(np.clip(0.5 * (np.trace(D, axis1=1, axis2=2) - 1), -1, 1))
        turn = (
            vee
            * np.where(angle > 1e-6, 0.5 * angle / np.maximum(np.sin(angle), 1e-9), 0.5)[:, None]
        )
        error = np.concatenate([p - tip, turn], 1)
        z = Rs[..., 2]
        J = np.concatenate([np.cross(z, tip[:, None] - ps), z], 2).swapaxes(1, 2)
        JJ = J @ J.swapaxes(1, 2) + 1e-9 * np.eye(6)
        dq = (J.swapaxes(1, 2) @ np.linalg.solve(JJ, error[..., None]))[..., 0]
        left = np.linalg.norm(error, axis=1)
        q += np.clip(np.where(left[:, None] > 1e-10, dq, 0.0), -most, most)
        return left

    def branches(
        self, R: np.ndarray, p: np.ndarray, line: float, rng: np.random.Generator, starts: int
    ) -> list[np.ndarray]:
        """Paths of the tool's line from its far end to a target, one for each branch found, (9, 6) each."""
        q = rng.uniform(-math.pi, math.pi, (starts, 6))
        for _ in range(50):
            left = self.step(q, R, p, 0.5)
        q = np.mod(q[left < 1e-8] + math.pi, 2 * math.pi) - math.pi
        found: list[np.ndarray] = []
        for row in q:
            near = [np.abs(np.mod(row - o + math.pi, 2 * math.pi) - math.pi).max() for o in found]
            if min(near, default=1.0) > 1e-3:
                found.append(row)
        if not found:
            return []
        path = [np.array(found)]
        for k in range(1, 9):
            q = path[-1].copy()
            for _ in range(12):
                left = self.step(q, R, p - R[:, 2] * line * k / 8, 0.2)
            q[(left > 1e-7) | (np.abs(q - path[-1]).max(1) > 0.4)] = np.nan
            path.append(q)
        paths = np.stack(path[::-1], 1)
        good = np.isfinite(paths).all((1, 2)) & (np.abs(paths) <= self.limit).all((1, 2))
        return [row for row in paths[good] if self.own(row).min() >= KEPT]

    def yawed(self, R: np.ndarray, p: np.ndarray, free: bool, *how: Any) -> list[np.ndarray]:
        """Paths as of `branches`, of six yaws where any will do; with few starts of two."""
        yaws = np.linspace(0, 2 * math.pi, 6 if how[-1] > 100 else 2, endpoint=False)
        some = yaws if free else yaws[:1]
        return [q for yaw in some for q in self.branches(R @ rpy(0, 0, yaw), p, *how)]

    def own(self, q: np.ndarray) -> np.ndarray:
        """Least distance of an arm's own links that are not neighbours (n,); the tool belongs to the last link."""
        a, b, r = self.bodies(q)
        pairs = [(i, j) for i in range(8) for j in range(i + 2, 8) if (i, j) != (5, 7)]
        i, j = np.array(pairs).T
        return (segments(a[:, i], b[:, i], a[:, j], b[:, j]) - r[i] - r[j]).min(1)


def segments(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Distances of segments: at the nearest points of their lines if within, else from an end."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = (
        np.maximum((x * y).sum(-1), 1e-12) if x is y else (x * y).sum(-1)
        for x, y in ((u, u), (v, v), (u, v))
    )
    uw, vw = (u * w).sum(-1), (v * w).sum(-1)
    s = np.clip((uv * vw - vv * uw) / np.maximum(uu * vv - uv * uv, 1e-12), 0, 1)
    t = np.clip((uv * s + vw) / vv, 0, 1)
    s = np.clip((uv * t - uw) / uu, 0, 1)
    return np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)


def cross(arms: list[Arm], left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Distances of two arms in n postures of both."""
    a, b, r = arms[0].bodies(left)
    c, d, s = arms[1].bodies(right)
    gap = segments(a[:, :, None], b[:, :, None], c[:, None], d[:, None])
    return (gap - r[:, None] - s).min((1, 2))


def urdf(links: tuple[Link, ...], limit: np.ndarray) -> str:
    """An arm's URDF."""
    rows = [(None, None, (0, 0, 0.035), (0, 0, 0.065), 0.06), *links]
    out = ['<robot name="arm">']
    for k, (xyz, turn, a, b, r) in enumerate(rows):
        middle, way = 0.5 * np.add(a, b), np.subtract(b, a, dtype=float)
        length = float(np.linalg.norm(way))
        lean = math.acos(way[2] / length), math.atan2(way[1], way[0])
        place = f'xyz="{" ".join(map(str, middle))}" rpy="0 {lean[0]} {lean[1]}"'
        shape = f'<capsule radius="{r}" length="{length}"/>'
        out.append(
            f'<link name="l{k}"><collision><origin {place}/><geometry>{shape}</geometry></collision></link>'
        )
        if k:
            place = f'xyz="{" ".join(map(str, xyz))}" rpy="{" ".join(map(str, turn))}"'
            ends = f'lower="{-limit[k - 1]}" upper="{limit[k - 1]}"'
            out.append(
                f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/>'
                f'<origin {place}/><axis xyz="0 0 1"/><limit effort="1" velocity="2.5" {ends}/></joint>'
            )
    return "\n".join(out) + "</robot>\n"


def robot(name: str, home: np.ndarray) -> str:
    """A robot file."""
    joints = [f"j{k}" for k in range(1, 7)]
    posture = ", ".join(f"{j}: {q!r}" for j, q in zip(joints, home.tolist(), strict=True))
    return (
        f"dualarm: robot/1\nname: {name}\nurdf: {name}.urdf\n"
        f"arms:\n  left: {{joints: [{', '.join(joints)}], flange: l6}}\n"
        "limits:\n  default:\n    {acceleration: top speed in 0.3 s, jerk: acceleration in 0.1 s, source: assumed}\n"
        f"postures:\n  home: {{{posture}}}\n"
    )
