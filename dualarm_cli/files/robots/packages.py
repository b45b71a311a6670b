"""Search for ROS packages and the meshes of a URDF in them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from pathlib import Path

from dualarm_cli.errors import InputError
from dualarm_cli.files.robots.urdf_tree import parse_xml
from dualarm_cli.files.source.projects import BadReferenceError, Project
from dualarm_cli.files.source.text_source import quote, read_text
from dualarm_cli.records import dataclass

_SCHEME = "package://"
MANIFEST = "package.xml"
"""File in the folder of each ROS package, with the package's name."""


@dataclass(frozen=True)
class PackageFinder:
    """Search for the packages and mesh files of one URDF."""

    project: Project
    """Project that relative paths must not leave."""
    urdf: Path
    """Path of the URDF."""
    packages: tuple[Path, ...] = ()
    """Folders of packages, or folders that hold packages, given by the user."""
    beyond: bool = False
    """Whether an import searches: packages above the project, names in package.xml, absolute paths."""
    depth: int = 3
    """Maximum depth of a package below a folder, such as a workspace's `src`."""
    _stated: dict[tuple[Path, int], list[tuple[str, Path]]] = field(default_factory=dict)
    """Packages by folder and depth, with their names in package.xml.

    Each folder is listed once.
    """

    def mesh(self, reference: str) -> Path:
        """Resolve a mesh reference to an existing file.

        Args:
            reference: a path relative to the URDF, `package://name/path`, or for an import an absolute path.

        Raises:
            BadReferenceError: there is no such file, or it may not be read.
        """
        if not reference.startswith(_SCHEME):
            local = reference.removeprefix("file://")
            if self.beyond and local.startswith("/"):
                return _absolute(Path(local))
            if local != reference:
                raise BadReferenceError(
                    f"{quote(reference)} is valid only on the machine that wrote it; write a path relative to the URDF"
                )
            return self.project.follow(reference, self.urdf)
        # Some files have a slash too many, `package:///name/path`; pinocchio reads them as well.
        package, _, rest = reference.removeprefix(_SCHEME).removeprefix("/").partition("/")
        if (
            not _is_name(package)
            or not rest
            or rest.startswith("/")
            or "\0" in reference
            or "\\" in reference
            or ".." in Path(rest).parts
        ):
            raise BadReferenceError(f"{quote(reference)} must be package://name/path")
        linked, present = False, None
        for folder, named in self._folders(package):
            path = folder / rest
            present = present or (folder if _is_folder(folder) else None)
            if not _is_file(path):
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
        if present is not None:
            raise BadReferenceError(
                f"there is no file {quote(rest)} in package {quote(package)}, which is {present}"
            )
        raise self._missing(package)

    def package(self, name: str, inside: Path) -> Path:
        """Find the folder of a package that a xacro file includes from.

        Folders without a package.xml count only if the user or ROS names them, or within a given folder.

        Args:
            name: name of the package.
            inside: folder that the xacro file may read anyway.

        Raises:
            BadReferenceError: there is no such package.
        """
        folders = [
            folder
            for folder, named in (self._folders(name) if _is_name(name) else ())
            if _is_folder(folder)
            and (
                named
                or _is_file(folder / MANIFEST)
                or Path(os.path.realpath(folder)).is_relative_to(inside)
            )
        ]
        if not folders:
            raise self._missing(name)
        # A repository often has the name of a package in it.
        return next((f for f in folders if _is_file(f / MANIFEST)), folders[0])

    def _missing(self, package: str) -> BadReferenceError:
        given = "".join(f"{folder}, " for folder in self.packages)
        return BadReferenceError(
            f"package {quote(package)} is not in {given}the folder of the URDF, in those above it, or in "
            "ROS_PACKAGE_PATH and AMENT_PREFIX_PATH; name its folder with `dualarm robot import --package-dir`"
        )

    def _folders(self, package: str) -> Iterator[tuple[Path, bool]]:
        """Iterate over candidate folders of a package.

        Each comes with whether the user or ROS names it.
        """
        for folder in self.packages:
            yield from ((path, True) for path in self._in(folder.absolute(), package, self.depth))
        urdf_folder = Path(os.path.realpath(self.urdf)).parent
        for folder in (urdf_folder, *urdf_folder.parents):
            within = folder.is_relative_to(self.project.folder)
            if within or self.beyond:
                for candidate in self._in(folder, package, 1):
                    if within or candidate == folder or _is_file(candidate / MANIFEST):
                        yield candidate, False
        for folder in ros_folders(os.environ):
            yield from ((path, True) for path in self._in(folder, package, self.depth))

    def _in(self, folder: Path, package: str, depth: int) -> Iterator[Path]:
        """Iterate over the folder itself and folders in it that have the package's name.

        For an import the name in a package.xml counts as well, down to a depth.
        """
        if folder.name == package:
            yield folder
        yield folder / package
        if self.beyond:
            key = folder, depth
            if key not in self._stated:
                self._stated[key] = list(_stated_packages(folder, depth))
            yield from (path for name, path in self._stated[key] if name == package)


def _is_file(path: Path) -> bool:
    """Check whether a file exists; without the right to look it does not."""
    return os.path.isfile(path)  # noqa: PTH113  Path.is_file raises there


def _is_folder(path: Path) -> bool:
    """Check whether a folder exists; without the right to look it does not."""
    return os.path.isdir(path)  # noqa: PTH112  Path.is_dir raises there


def _is_name(package: str) -> bool:
    return package not in ("", ".", "..") and not set(package) & set("/\\\0")


def _absolute(path: Path) -> Path:
    """Return the path of a file that exists on this machine.

    Raises:
        BadReferenceError: it does not.
    """
    if _is_file(path):
        return path
    folder = path.parent
    what = f"file {quote(str(path))}" if _is_folder(folder) else f"folder {quote(str(folder))}"
    raise BadReferenceError(
        f"there is no {what} on this machine; import the xacro file here, or write package://name/path or a path "
        "relative to the URDF"
    )


def _stated_packages(folder: Path, depth: int) -> Iterator[tuple[str, Path]]:
    """Iterate over the packages in a folder, with the names in their package.xml.

    Packages hold no others.
    """
    manifest = folder / MANIFEST
    if _is_file(manifest):
        try:
            name = parse_xml(read_text(manifest, str(manifest))).find("name")
        except InputError:
            return
        yield name.text.strip() if name else "", folder
    elif depth:
        try:
            children = sorted(folder.iterdir())
        except OSError:  # a file, or not readable
            return
        for child in children:
            if not child.name.startswith("."):
                yield from _stated_packages(child, depth - 1)


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
