"""Export of the moving cell as a glTF 2.0 scene in one binary file."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from dualarm_cli.formats.markers import COLOURS
from dualarm_cli.formats.request import ExportRequest
from dualarm_cli.formats.solid_meshes import solid_mesh
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.page.carried_objects import carried_objects
from dualarm_cli.page.scene import WORLD_BODY, DrawnHulls, bodies, poses_at, solids
from dualarm_cli.verification.as_done import job_as_done

FLOAT, UNSIGNED = 5126, 5125
"""Component types: float32 and uint32."""
VERTICES, INDICES = 34962, 34963
"""Targets of buffer views."""
Y_UP = (-(0.5**0.5), 0.0, 0.0, 0.5**0.5)
"""Quaternion that turns z, up in a cell, to y, up in glTF."""


def files(request: ExportRequest) -> Mapping[str, Iterable[bytes]]:
    """Build the scene file; lengths are in m.

    Links, tools, obstacles and parts are meshes; joints are animated nodes.
    """
    schedule, job = request.schedule, request.job
    assert job is not None
    hulls, scene = DrawnHulls(), _Scene()
    samples = request.samples()
    selected = _distinct(samples.time)
    frames = samples.time[selected]
    model = pin.buildModelFromXML(job.cell.robot.urdf)
    root = scene.node("cell", None, {"rotation": list(Y_UP)})
    holders = {WORLD_BODY: root}
    times = scene.array(frames[:, None], "SCALAR", extremes=True)
    for number, body in enumerate(bodies(model, job.cell.robot, job.cell.base)):
        placed = {"translation": body["xyz"], "rotation": body["quat"]}
        name = body["name"] or schedule.robot.name
        mount = scene.node(f"{name} mount" if number else name, holders[body["parent"]], placed)
        holders[number] = mount
        if number:
            holders[number] = scene.node(name, mount, {})
            positions = samples.position[selected, samples.joints.index(name)]
            scene.animate(holders[number], times, *_motion(body, positions))
    done = job_as_done(schedule, job)
    for solid in solids(model, job.cell, hulls):
        scene.solid(solid, holders[solid["body"]], solid["role"], hulls)
    for carried in carried_objects(schedule, done, hulls):
        if not carried["solids"]:
            continue
        instants = _instants(carried, frames)
        translations, rotations = _object_poses(carried, instants, request, model)
        initial_pose = {"translation": translations[0].tolist(), "rotation": rotations[0].tolist()}
        node = scene.node(carried["name"], root, initial_pose)
        track = scene.array(instants[:, None], "SCALAR", extremes=True)
        scene.animate(node, track, "translation", translations)
        scene.animate(node, track, "rotation", rotations)
        for solid in carried["solids"]:
            scene.solid(solid | {"name": carried["name"]}, node, carried["role"], hulls)
    return {"scene.glb": [scene.binary(schedule.provenance.version)]}


def _motion(body: Mapping[str, Any], positions: FloatArray) -> tuple[str, FloatArray]:
    """Return the animated property of a joint's node, and its values."""
    axis = np.array(body["axis"])
    if body["slides"]:
        return "translation", positions[:, None] * axis
    half = positions[:, None] / 2.0
    return "rotation", np.column_stack([np.sin(half) * axis, np.cos(half)])


def _instants(carried: Mapping[str, Any], frames: FloatArray) -> FloatArray:
    """Select the instants of an object's keyframes: at changes of carrier, and throughout carrying.

    Between keyframes a lying object, or one on a conveyor, moves linearly.
    """
    steps = carried["keyframes"]
    ends = np.array([*(step["time"] for step in steps), frames[-1]])
    is_carried = np.array([step["body"] != WORLD_BODY for step in steps])
    index = np.clip(np.searchsorted(ends[:-1], frames, side="right") - 1, 0, None)
    instants = np.union1d(frames[is_carried[index]], np.append(ends, frames[0]))
    instants = instants[instants <= frames[-1]]
    return instants[_distinct(instants)]


def _distinct(times: FloatArray) -> BoolArray:
    """Mark the times (m,) that still rise in single precision, as glTF requires."""
    single = times.astype(np.float32)
    return np.concatenate([[True], np.diff(single) > 0.0])


def _object_poses(
    carried: Mapping[str, Any], instants: FloatArray, request: ExportRequest, model: pin.Model
) -> tuple[FloatArray, FloatArray]:
    """Compute an object's world positions (m, 3) and quaternions (m, 4) at instants (m,)."""
    job, steps = request.job, carried["keyframes"]
    assert job is not None
    positions = request.schedule.trajectory.select(job.cell.robot.joints).clamped(instants)[0]
    begins = np.array([step["time"] for step in steps])
    index = np.clip(np.searchsorted(begins, instants, side="right") - 1, 0, None)
    translations, rotations = np.empty((len(instants), 3)), np.empty((len(instants), 4))
    for k, time in enumerate(instants):
        step = steps[index[k]]
        pose = pin.SE3(pin.Quaternion(np.array(step["quat"])).matrix(), np.array(step["xyz"]))
        if step["body"] == WORLD_BODY:
            pose.translation = pose.translation + (time - step["time"]) * np.array(step["velocity"])
        else:
            holders = poses_at(model, job.cell.robot, job.cell.base, positions[k])
            pose = holders[step["body"]] * pose
        translations[k] = pose.translation
        rotations[k] = pin.Quaternion(pose.rotation).coeffs()
    # q and -q are the same rotation: viewers interpolate the shorter arc between neighbours of equal sign.
    away = (rotations[1:] * rotations[:-1]).sum(axis=1) < 0.0
    rotations[1:][np.cumsum(away) % 2 == 1] *= -1.0
    return translations, rotations


class _Scene:
    """Builder of the nodes, meshes and arrays of a glTF file."""

    def __init__(self) -> None:
        self.nodes: list[dict[str, Any]] = []
        self.meshes: list[dict[str, Any]] = []
        self.materials: dict[str, int] = {}
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        self.samplers: list[dict[str, Any]] = []
        self.channels: list[dict[str, Any]] = []
        self.content = bytearray()

    def node(self, name: str, parent: int | None, placed: Mapping[str, Any]) -> int:
        """Add a child node and return its number."""
        number = len(self.nodes)
        self.nodes.append({"name": name, **placed})
        if parent is not None:
            self.nodes[parent].setdefault("children", []).append(number)
        return number

    def array(
        self, values: Any, kind: str, target: int | None = None, *, extremes: bool = False
    ) -> int:
        """Add an array of float32 or uint32, shape (m, c), and return its accessor."""
        whole = np.issubdtype(np.asarray(values).dtype, np.integer)
        rows = np.ascontiguousarray(values, dtype="<u4" if whole else "<f4")
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.content)}
        view["byteLength"] = rows.nbytes
        if target is not None:
            view["target"] = target
        accessor: dict[str, Any] = {
            "bufferView": len(self.views),
            "componentType": UNSIGNED if whole else FLOAT,
            "count": len(rows),
            "type": kind,
        }
        if extremes:
            accessor |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        self.views.append(view)
        self.accessors.append(accessor)
        self.content += rows.tobytes()
        return len(self.accessors) - 1

    def solid(self, solid: Mapping[str, Any], node: int, role: str, hulls: DrawnHulls) -> None:
        """Add a solid of the page's data below a node."""
        corners, triangles = solid_mesh(solid, hulls)
        attributes = {"POSITION": self.array(corners, "VEC3", VERTICES, extremes=True)}
        indices = self.array(triangles.reshape(-1, 1), "SCALAR", INDICES)
        primitive = {"attributes": attributes, "indices": indices, "material": self._material(role)}
        self.meshes.append({"name": solid["name"], "primitives": [primitive]})
        placed = {"translation": solid["xyz"], "rotation": solid["quat"]}
        self.node(solid["name"], node, placed | {"mesh": len(self.meshes) - 1})

    def _material(self, role: str) -> int:
        return self.materials.setdefault(role, len(self.materials))

    def animate(self, node: int, times: int, path: str, values: FloatArray) -> None:
        """Add a channel that interpolates a node's translation or rotation linearly."""
        kind = "VEC3" if path == "translation" else "VEC4"
        sampler = {"input": times, "output": self.array(values, kind), "interpolation": "LINEAR"}
        self.samplers.append(sampler)
        target = {"node": node, "path": path}
        self.channels.append({"sampler": len(self.samplers) - 1, "target": target})

    def binary(self, version: str) -> bytes:
        """Encode the file: a header, the scene as JSON, and the arrays."""
        scene = {
            "asset": {"version": "2.0", "generator": f"dualarm {version}"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": [_material(role) for role in self.materials],
            "animations": [
                {"name": "schedule", "samplers": self.samplers, "channels": self.channels}
            ],
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": len(self.content)}],
        }
        scene = {key: value for key, value in scene.items() if value != []}
        text = json.dumps(scene, ensure_ascii=False).encode("utf-8", "backslashreplace")
        chunks = [(b"JSON", text + b" " * (-len(text) % 4)), (b"BIN\0", bytes(self.content))]
        length = 12 + sum(8 + len(data) for _, data in chunks)
        parts = [struct.pack("<4sII", b"glTF", 2, length)]
        for kind, data in chunks:
            parts += [struct.pack("<I4s", len(data), kind), data]
        return b"".join(parts)


def _material(role: str) -> dict[str, Any]:
    colour: Sequence[float] = COLOURS[role]
    about: dict[str, Any] = {
        "name": role,
        "doubleSided": True,
        "pbrMetallicRoughness": {
            "baseColorFactor": list(colour),
            "metallicFactor": 0.1,
            "roughnessFactor": 0.8,
        },
    }
    return about | ({"alphaMode": "BLEND"} if colour[3] < 1.0 else {})
