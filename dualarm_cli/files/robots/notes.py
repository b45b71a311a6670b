"""Notes on how robot files, their URDFs and meshes were interpreted."""

from __future__ import annotations

from dualarm_cli.notes import NoteTable

robot_note = NoteTable(
    "robot",
    of_robot="{robot}: {note}",
    equal_soft_limits="{joint}: its soft limits are equal and ignored, because they allow no motion",
    continuous="{joint} is continuous; its position is kept within ±{limit:g} rad",
    narrowed="position limits are narrowed by {cause}: {joints:listed}",
    slowed="controllers slow joints down before their soft limits (k_position of the URDF), which plans do not: from "
    "{distance} on, {joints:listed}; `position_margin` keeps away from there",
    jerk_rule="no jerk limit is given for {joints:*, }: `{rule}` is assumed; give `jerk`, or `jerk: none` for "
    "no limit",
    fixed="joints that neither platform nor arms name are fixed: {places:*; }",
    followers="joints that mimic moving ones stand still, their links' shapes with them: {joints:listed}",
    assumed_contacts="collisions are not checked between {pairs:listed}: `assumed_contacts` assumes that only "
    "their shapes touch",
    hulls="collision meshes are taken as their convex hulls: {links:listed}",
    units="units of COLLADA files are applied, as in RViz but not in MoveIt's collision checks: {files:*, }",
)
