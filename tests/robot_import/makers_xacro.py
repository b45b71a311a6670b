"""ROS packages with xacro files of the structures that makers of robots use, and a stub of ROS's package index."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from textwrap import dedent

SPACE = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
JOINT = """
  <xacro:macro name="turn" params="name parent child *origin axis:='0 0 1' lower:=-3 upper:=3 speed:=2">
    <link name="${child}">
      <collision><origin xyz="0 0 0.05"/><geometry><cylinder radius="0.03" length="0.1"/></geometry></collision>
    </link>
    <joint name="${name}" type="revolute">
      <parent link="${parent}"/><child link="${child}"/>
      <xacro:insert_block name="origin"/>
      <axis xyz="${axis}"/><limit lower="${lower}" upper="${upper}" velocity="${speed}" effort="1"/>
    </joint>
  </xacro:macro>
"""
ARM = """
  <xacro:include filename="$(find common_resources)/xacro/joint.xacro"/>
  <xacro:macro name="arm" params="prefix parent:=base *mount count:=6">
    <xacro:property name="axes" value="${['0 0 1', '0 1 0', '0 1 0', '0 0 1', '0 1 0', '0 0 1', '0 1 0']}"/>
    <xacro:turn name="${prefix}joint1" parent="${parent}" child="${prefix}link1">
      <xacro:insert_block name="mount"/>
    </xacro:turn>
    <xacro:macro name="rest" params="prefix k count">
      <xacro:property name="link" value="${prefix}link"/>
      <xacro:turn name="${prefix}joint${k}" parent="${link}${k - 1}" child="${link}${k}" axis="${axes[k - 1]}">
        <origin xyz="0 0 ${0.1 + 0.05 * (k % 3)}" rpy="0 0 ${radians(5 * k)}"/>
      </xacro:turn>
      <xacro:if value="${k &lt; count}"><xacro:rest prefix="${prefix}" k="${k + 1}" count="${count}"/></xacro:if>
    </xacro:macro>
    <xacro:rest prefix="${prefix}" k="${2}" count="${count}"/>
  </xacro:macro>
"""
GRIPPER = """
  <xacro:macro name="gripper" params="prefix parent mesh_root:='package://maker_gripper/meshes'">
    <link name="${prefix}gripper">
      <collision><geometry><mesh filename="${mesh_root}/gripper.obj" scale="0.5 0.5 0.5"/></geometry></collision>
    </link>
    <joint name="${prefix}gripper_joint" type="fixed">
      <parent link="${parent}"/><child link="${prefix}gripper"/><origin xyz="0 0 0.02" rpy="0 0 ${pi / 4}"/>
    </joint>
  </xacro:macro>
"""
MOUNT = '<origin xyz="0 0 0.2"/>'
BASE = '<link name="base"/>'
INCLUDE_ARM = '<xacro:include filename="$(find maker_arm)/urdf/arm.xacro"/>'
INCLUDE_GRIPPER = '<xacro:include filename="$(find maker_gripper)/urdf/gripper.xacro"/>'
TETRAHEDRON = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
LIMITS = "joint_limits:\n  one: {lower: !degrees -170, upper: !degrees 170, speed: 1.5}\n"


def robot(content: str, name: str = "maker") -> str:
    """Wraps elements as a xacro file."""
    return f'<?xml version="1.0"?>\n<robot name="{name}" {SPACE}>\n{content}\n</robot>\n'


FILES: Mapping[str, str] = {
    # A repository with another name than its package; a package beside it; packages two levels down in a workspace.
    "Maker_ROS2_Description:maker_arm/urdf/arm.xacro": robot(ARM),
    "Maker_ROS2_Description:maker_arm/config/five/limits.yaml": LIMITS,
    "common_resources:common_resources/xacro/joint.xacro": robot(JOINT),
    "grippers/maker_gripper:maker_gripper/urdf/gripper.xacro": robot(GRIPPER),
    "grippers/maker_gripper:maker_gripper/meshes/gripper.obj": TETRAHEDRON,
}
"""Files of packages: `folder of the package:name in its package.xml/path`."""
ROBOTS: Mapping[str, tuple[str, Mapping[str, str]]] = {
    "own": (f'{INCLUDE_ARM}{BASE}<xacro:arm prefix="">{MOUNT}</xacro:arm>', {}),
    "gripper": (
        f'{INCLUDE_ARM}{INCLUDE_GRIPPER}{BASE}<xacro:arm prefix="">{MOUNT}</xacro:arm>'
        '<xacro:gripper prefix="" parent="link6"/>',
        {},
    ),
    "file_meshes": (
        f'{INCLUDE_ARM}{INCLUDE_GRIPPER}{BASE}<xacro:arm prefix="">{MOUNT}</xacro:arm>'
        '<xacro:gripper prefix="" parent="link6" mesh_root="file://$(find maker_gripper)/meshes"/>',
        {},
    ),
    "absolute_meshes": (
        f'{INCLUDE_ARM}{INCLUDE_GRIPPER}{BASE}<xacro:arm prefix="">{MOUNT}</xacro:arm>'
        '<xacro:gripper prefix="" parent="link6" mesh_root="$(find maker_gripper)/meshes"/>',
        {},
    ),
    "prefix": (
        f'{INCLUDE_ARM}<xacro:arg name="prefix" default="a_"/>{BASE}'
        f'<xacro:arm prefix="$(arg prefix)">{MOUNT}</xacro:arm>',
        {"prefix": "left_"},
    ),
    "dof": (
        f'{INCLUDE_ARM}<xacro:arg name="dof" default="6"/>{BASE}'
        f'<xacro:arm prefix="" count="$(arg dof)">{MOUNT}</xacro:arm>',
        {"dof": "7"},
    ),
    "one_armed": (
        f'{INCLUDE_ARM}<xacro:arg name="bimanual" default="false"/><xacro:arg name="simulated" default="true"/>{BASE}'
        f'<xacro:unless value="$(arg bimanual)"><xacro:arm prefix="">{MOUNT}</xacro:arm></xacro:unless>'
        '<xacro:if value="$(arg bimanual)"><xacro:arm prefix="left_"><origin xyz="0 0.3 0"/></xacro:arm>'
        '<xacro:arm prefix="right_"><origin xyz="0 -0.3 0"/></xacro:arm></xacro:if>',
        {},
    ),
    "yaml": (
        f'{INCLUDE_ARM}<xacro:arg name="type" default="five"/>{BASE}'
        '<xacro:property name="file" value="$(find maker_arm)/config/$(arg type)/limits.yaml"/>'
        '<xacro:property name="limits" value="${xacro.load_yaml(file)[\'joint_limits\']}"/>'
        '<xacro:turn name="one" parent="base" child="tip" lower="${limits.one.lower}"'
        ' upper="${limits[\'one\'][\'upper\']}" speed="${limits.one.speed}"><origin xyz="0 0 0.3"/></xacro:turn>',
        {},
    ),
    "spaces": (
        '<xacro:include filename="$(find common_resources)/xacro/joint.xacro" ns="common"/>'
        f'{BASE}<xacro:common.turn name="one" parent="base" child="tip"><origin xyz="1 0 0"/></xacro:common.turn>',
        {},
    ),
    "relative_yaml": (
        f'{INCLUDE_ARM}{BASE}<xacro:property name="file" value="${{xacro.load_yaml(\'../config/five/limits.yaml\')}}"/>'
        '<xacro:arm prefix="d_"><origin xyz="0 0 ${file.joint_limits.one.speed}"/></xacro:arm>',
        {},
    ),
    "relative": (
        f'<xacro:include filename="arm.xacro"/>{BASE}<xacro:arm prefix="r_">{MOUNT}</xacro:arm>',
        {},
    ),
    "eval": (
        f'{INCLUDE_ARM}<xacro:arg name="tilt" default="0.1"/>{BASE}'
        '<xacro:property name="tilt" value="$(eval 2 * tilt)"/>'
        '<xacro:arm prefix=""><origin xyz="0 0 0.2" rpy="${tilt} 0 0"/></xacro:arm>',
        {"tilt": "0.25"},
    ),
    "optional": (
        f'<xacro:include filename="$(find maker_arm)/urdf/extra.xacro" optional="true"/>{INCLUDE_ARM}{BASE}'
        f'<xacro:arm prefix="">{MOUNT}</xacro:arm>',
        {},
    ),
    "chosen_file": (
        '<xacro:arg name="part" default="none"/><xacro:include filename="$(find maker_arm)/urdf/$(arg part).xacro"/>'
        f'{BASE}<xacro:arm prefix="c_">{MOUNT}</xacro:arm>',
        {"part": "arm"},
    ),
    "computed_package": (
        '<xacro:property name="package" value="maker_arm"/>'
        f'<xacro:include filename="$(find ${{package}})/urdf/arm.xacro"/>{BASE}'
        f'<xacro:arm prefix="">{MOUNT}</xacro:arm>',
        {},
    ),
    "property_path": (
        '<xacro:property name="root" value="$(find maker_arm)"/><xacro:include filename="${root}/urdf/arm.xacro"/>'
        f'{BASE}<xacro:arm prefix="">{MOUNT}</xacro:arm>',
        {},
    ),
    "rail": (
        f'{INCLUDE_ARM}<link name="world"/><link name="base"/><joint name="rail" type="prismatic">'
        '<parent link="world"/><child link="base"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="${2 * 1.5}" velocity="1" effort="1"/></joint>'
        f'<xacro:arm prefix="">{MOUNT}</xacro:arm>',
        {},
    ),
    "blocks": (
        f'{INCLUDE_ARM}<xacro:macro name="twice" params="**content"><xacro:insert_block name="content"/></xacro:macro>'
        f'{BASE}<xacro:twice><content><xacro:arm prefix="left_"><origin xyz="0 0.3 0"/></xacro:arm>'
        '<xacro:arm prefix="right_"><origin xyz="0 -0.3 0"/></xacro:arm></content></xacro:twice>',
        {},
    ),
    "globbed": (
        f'<xacro:include filename="$(find maker_arm)/urdf/ar*.xacro"/>{BASE}<xacro:arm prefix="g_">{MOUNT}</xacro:arm>',
        {},
    ),
    "expressions": (
        f'{INCLUDE_ARM}<xacro:property name="sides" value="${{dict(left=1, right=-1)}}"/>{BASE}'
        '<xacro:arm prefix="left_"><origin xyz="0 ${0.3 * sides[\'left\']} 0" rpy="${-pi / 2} 0 0"/></xacro:arm>'
        '<xacro:arm prefix="right_"><origin xyz="0 ${0.3 * sides[\'right\']} 0" rpy="${pi / 2} 0 0"/></xacro:arm>',
        {},
    ),
}
"""Top files by name, in the package maker_arm: their content, and arguments."""
INDEX = """
    import os

    def get_package_share_directory(name):
        for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep):
            if os.path.isfile(f"{prefix}/share/ament_index/resource_index/packages/{name}"):
                return f"{prefix}/share/{name}"
        raise KeyError(name)
"""
REFERENCE = """
    import json, sys, xacro

    print(json.dumps([xacro.process_file(file, mappings=dict(a)).toxml() for file, a in json.loads(sys.stdin.read())]))
"""


def write_workspace(folder: Path) -> Path:
    """Writes the packages as makers' repositories, and returns the folder of the top files."""
    for place, text in FILES.items():
        home, _, path = place.partition(":")
        package, _, inside = path.partition("/")
        file = folder / home / inside
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        (folder / home / "package.xml").write_text(f"<package><name> {package} </name></package>")
    home = folder / "Maker_ROS2_Description/urdf"
    for name, (content, _) in ROBOTS.items():
        (home / f"{name}.urdf.xacro").write_text(robot(content, name))
    return home


def write_installed(folder: Path) -> None:
    """Writes the packages as colcon installs them, with a stub of ROS's index in `python`."""
    index = folder / "share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    for place, text in FILES.items():
        package, _, inside = place.partition(":")[2].partition("/")
        file = folder / "share" / package / inside
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        (index / package).write_text("")
    for name, (content, _) in ROBOTS.items():
        path = folder / "share/maker_arm/urdf" / f"{name}.urdf.xacro"
        path.write_text(robot(content, name))
    module = folder / "python/ament_index_python"
    module.mkdir(parents=True)
    (module / "__init__.py").write_text("")
    (module / "packages.py").write_text(dedent(INDEX))
