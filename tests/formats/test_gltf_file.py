"""The scene, read by pygltflib and trimesh; its animation replayed and compared with forward kinematics."""

from __future__ import annotations

import io

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from pygltflib import GLTF2

from dualarm_cli.formats import export
from dualarm_cli.formats.solid_meshes import solid_mesh
from dualarm_cli.page.scene import DrawnHulls


@pytest.fixture(scope="module")
def content(exported):
    """The file."""
    return b"".join(export("gltf", exported.request(50.0))["scene.glb"])


def array(scene, number):
    """Returns an accessor's values."""
    accessor = scene.accessors[number]
    view = scene.bufferViews[accessor.bufferView]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor.type]
    kind = {5126: "<f4", 5125: "<u4"}[accessor.componentType]
    data = scene.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
    values = np.frombuffer(data, kind).reshape(-1, width)
    assert len(values) == accessor.count
    return values


def placed(node, changes):
    """Returns a node's pose in its parent."""
    xyz = changes.get("translation", node.translation or [0, 0, 0])
    x, y, z, w = changes.get("rotation", node.rotation or [0, 0, 0, 1])
    turn = pin.Quaternion(float(w), float(x), float(y), float(z)).normalized()
    return pin.SE3(turn.matrix(), np.array(xyz, dtype=float))


def test_the_animation_moves_the_links_as_the_joints_say(exported, content):
    """At each tenth sample every joint's node is where pinocchio has the joint, to float32."""
    scene = GLTF2().load_from_bytes(content)
    parents = {child: k for k, node in enumerate(scene.nodes) for child in node.children or []}
    [animation] = scene.animations
    changes = {}
    for channel in animation.channels:
        sampler = animation.samplers[channel.sampler]
        track = (array(scene, sampler.input)[:, 0], array(scene, sampler.output))
        changes.setdefault(channel.target.node, {})[channel.target.path] = track
    job = exported.job
    model = pin.buildModelFromXML(job.cell.robot.urdf)
    data = model.createData()
    by_name = {node.name: k for k, node in enumerate(scene.nodes) if k in changes}
    times = next(iter(changes[by_name[model.names[1]]].values()))[0]
    assert times[-1] == pytest.approx(exported.schedule.duration, abs=1e-5)
    up = placed(scene.nodes[0], {})
    for k in range(0, len(times), 10):
        q = np.zeros(model.nq)
        motion = exported.schedule.trajectory.select(job.cell.robot.joints)
        # In float32 the last time may be after the end.
        time = np.minimum(times[k : k + 1].astype(float), exported.schedule.duration)
        for name, value in zip(motion.joints, motion.at(time)[0][0], strict=True):
            q[model.idx_qs[model.getJointId(name)]] = value
        pin.forwardKinematics(model, data, q)
        for joint in range(1, model.njoints):
            pose, number = pin.SE3.Identity(), by_name[model.names[joint]]
            while number is not None:
                now = {path: v[1][k] for path, v in changes.get(number, {}).items()}
                pose = placed(scene.nodes[number], now) * pose
                number = parents.get(number)
            expected = up * job.cell.base * data.oMi[joint]
            np.testing.assert_allclose(pose.homogeneous, expected.homogeneous, atol=2e-5)


def test_a_part_is_at_its_place_at_the_end(exported, content):
    """Where the last event that lets go of it has the tool, its node is within the part's grip."""
    scene = GLTF2().load_from_bytes(content)
    [animation] = scene.animations
    for task in {task.id: task for task in exported.job.tasks if task.part}.values():
        let_go = [e for e in exported.schedule.events if (e.task, e.action) == (task.id, "place")]
        [number] = [k for k, n in enumerate(scene.nodes) if n.name == task.id and n.mesh is None]
        [channel] = [
            c
            for c in animation.channels
            if (c.target.node, c.target.path) == (number, "translation")
        ]
        last = array(scene, animation.samplers[channel.sampler].output)[-1]
        events = {e.action: e for e in exported.schedule.events if e.task == task.id}
        if let_go and not let_go[-1].moves:
            # The part's frame is that of the tool that picks it, and stays so in the other arm's hand.
            grip = exported.job.cell.T_own_tool(events["pick"].arm, task.tool)
            if "give" in events:
                grip = events["take"].pose.actInv(events["give"].pose) * grip
            np.testing.assert_allclose(last, (let_go[-1].pose * grip).translation, atol=1e-5)


def test_a_part_follows_its_arm_at_any_instant(exported, content):
    """Between the pick and the giving event, and after it, its node is where the tool has it, to the linear frames."""
    scene = GLTF2().load_from_bytes(content)
    [animation] = scene.animations
    model = pin.buildModelFromXML(exported.job.cell.robot.urdf)
    data = model.createData()
    for task in {task.id: task for task in exported.job.tasks if task.part}.values():
        events = {e.action: e for e in exported.schedule.events if e.task == task.id}
        [number] = [k for k, n in enumerate(scene.nodes) if n.name == task.id and n.mesh is None]
        [sampler] = [
            animation.samplers[c.sampler]
            for c in animation.channels
            if (c.target.node, c.target.path) == (number, "translation")
        ]
        times, way = array(scene, sampler.input)[:, 0], array(scene, sampler.output)
        pick, end = events["pick"], events.get("give", events["place"])
        arm = exported.job.cell.robot.arm(pick.arm)
        tcp = exported.job.cell.tools[pick.arm].tcp
        grip = exported.job.cell.T_own_tool(pick.arm, task.tool)
        motion = exported.schedule.trajectory.select(exported.job.cell.robot.joints)
        for time in np.linspace(pick.time, end.time, 23):
            q = np.zeros(model.nq)
            for name, value in zip(motion.joints, motion.at(np.array([time]))[0][0], strict=True):
                q[model.idx_qs[model.getJointId(name)]] = value
            pin.framesForwardKinematics(model, data, q)
            flange = data.oMf[model.getFrameId(arm.flange, pin.FrameType.BODY)]
            expected = (exported.job.cell.base * flange * tcp * grip).translation
            found = [np.interp(time, times, way[:, axis]) for axis in range(3)]
            # A chord of 20 ms at 10 m/s² is half a millimetre beside its arc.
            np.testing.assert_allclose(found, expected, atol=1.5e-3)


def test_times_of_animations_rise_in_single_precision(exported):
    """At 10 kHz, and where a part changes hands a nanosecond after a sample."""
    scene = GLTF2().load_from_bytes(
        b"".join(export("gltf", exported.request(10_000.0))["scene.glb"])
    )
    for sampler in scene.animations[0].samplers:
        times, values = array(scene, sampler.input)[:, 0], array(scene, sampler.output)
        assert (np.diff(times) > 0.0).all()
        assert len(times) == len(values)
        accessor = scene.accessors[sampler.input]
        assert (accessor.min[0], accessor.max[0]) == (times[0], times[-1])


def test_trimesh_reads_closed_solids_of_the_right_size(exported, content):
    """Every solid is watertight with its faces outwards, and the scene is as large as the cell is."""
    scene = trimesh.load(io.BytesIO(content), file_type="glb")
    for mesh in scene.geometry.values():
        mesh.merge_vertices()
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume > 0


@pytest.mark.parametrize(
    ("kind", "size", "volume"),
    [
        ("box", (0.2, 0.3, 0.4), 0.024),
        ("sphere", (0.5,), np.pi / 6),
        ("cylinder", (0.5, 2.0), np.pi / 2),
        ("capsule", (0.5, 2.0), np.pi / 2 + np.pi / 6),
    ],
)
def test_solids_have_the_volume_of_their_formula(kind, size, volume):
    """From inside and by at most a twentieth: round ones are polyhedra with their corners on the surface."""
    corners, triangles = solid_mesh({"kind": kind, "size": size, "hull": None}, DrawnHulls())
    mesh = trimesh.Trimesh(corners, triangles)
    mesh.merge_vertices()
    assert mesh.is_watertight
    assert 0.95 * volume < mesh.volume <= volume * (1 + 1e-9)
