"""Search for the meshes of a URDF, locally or in a ROS package."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from dualarm_cli.files.source.projects import BadReferenceError, Project
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.records import dataclass

_SCHEME = "package://"


@dataclass(frozen=True)
class MeshFinder:
    """Search for the mesh files of one URDF."""

    project: Project
    """Project that relative paths must not leave."""
    urdf: Path
    """Path of the URDF."""
    packages: tuple[Path, ...] = ()
    """Folders of packages, or folders that hold packages, given by the user."""
    beyond: bool = False
    """Whether packages above the project are searched: the URDF's own, and those with a
    package.xml."""

    def find(self, reference: str) -> Path:
        """Resolve a mesh reference, relative or in a package, to an existing file.

        Args:
            reference: a path relative to the URDF, or `package://name/path`.

        Raises:
            BadReferenceError: there is no such file, or it may not be read.
        """
        if not reference.startswith(_SCHEME):
            if reference.startswith("file://"):
                raise BadReferenceError(
                    f"{quote(reference)} is valid only on the machine that wrote it; write a path relative to the URDF"
                )
            return self.project.follow(reference, self.urdf)
        # Some files have a slash too many, `package:///name/path`; pinocchio reads them as well.
        package, _, rest = reference.removeprefix(_SCHEME).removeprefix("/").partition("/")
        if (
            package in ("", ".", "..")
            or not rest
            or rest.startswith("/")
            or "\0" in reference
            or "\\" in reference
            or ".." in Path(rest).parts
        ):
            raise BadReferenceError(f"{quote(reference)} must be package://name/path")
        linked = False
        for folder, named in self._folders(package):
            path = folder / rest
            if not path.is_file():
                continue
            # Colcon installs files as links to their sources, so packages named by the user may hold such links.
            if named or Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
                return path
            linked = True
        if linked:
            raise BadReferenceError(
                f"{quote(reference)} leads out of its package by a symbolic link; name the package's folder with "
                "`dualarm robot import --package-dir`"
            )
        raise BadReferenceError(
            f"there is no file {quote(reference)}: package {quote(package)} is not in the folder of the URDF, in those "
            "above it, or in ROS_PACKAGE_PATH and AMENT_PREFIX_PATH; name its folder with "
            "`dualarm robot import --package-dir`"
        )

    def _folders(self, package: str) -> Iterator[tuple[Path, bool]]:
        """Iterate over candidate folders of a package.

        Each comes with whether the user or ROS names it.
        """
        for folder in self.packages:
            yield from ((candidate, True) for candidate in _as_package(folder, package))
        urdf_folder = Path(os.path.realpath(self.urdf)).parent
        for folder in (urdf_folder, *urdf_folder.parents):
            if folder.is_relative_to(self.project.folder):
                yield from ((candidate, False) for candidate in _as_package(folder, package))
            elif self.beyond:
                for candidate in _as_package(folder, package):
                    if candidate == folder or (candidate / "package.xml").is_file():
                        yield candidate, False
        for folder in ros_folders(os.environ):
            yield folder / package, True


def _as_package(folder: Path, package: str) -> Iterator[Path]:
    """Iterate over the folder itself and its child if they have the package's name."""
    if folder.name == package:
        yield folder
    yield folder / package


def ros_folders(environment: Mapping[str, str]) -> Sequence[Path]:
    """List the parent folders of ROS packages from environment variables.

    Args:
        environment: variables; ROS_PACKAGE_PATH of ROS 1 and AMENT_PREFIX_PATH of ROS 2 are read.
    """
    first = [Path(p) for p in environment.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
    second = [
        Path(p) / "share" for p in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p
    ]
    return [*first, *second]
