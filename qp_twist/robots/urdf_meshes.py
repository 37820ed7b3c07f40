"""Find the mesh files of a URDF, and report missing ones."""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from qp_twist.errors import InvalidInput
from qp_twist.files import read_bytes
from qp_twist.robots.ros_packages import package_folders
from qp_twist.robots.wording import listed

_IN_PACKAGE = re.compile(r"(?:package|model)://([^/]+)/(.+)")


class Meshes(NamedTuple):
    """The meshes of a file."""

    assets: dict[str, bytes]
    """Their contents, by their new names in the tree."""
    stated: dict[str, str]
    """Their names in the file, by the same new names."""
    left_out: list[str]


def take_meshes(root: ET.Element, file: Path, packages: Mapping[str, Path]) -> Meshes:
    """Read the mesh files of a URDF; remove shapes whose mesh is not found.

    The tree gets short names, one for each file and scale, since MuJoCo's reader identifies files
    by name. Visual shapes are removed, as MuJoCo does, unless there are no others or
    ``<mujoco><compiler discardvisual="false"/></mujoco>`` in the file keeps them.
    """
    compiler = _compiler(root)
    folder = file.parent / compiler.attrib.pop("meshdir", "")
    for attribute in ("assetdir", "strippath"):
        compiler.attrib.pop(attribute, None)
    if compiler.get("discardvisual") != "false":
        if root.find("link/collision") is None:
            compiler.set("discardvisual", "false")
        else:
            for link in root.findall("link"):
                for visual in link.findall("visual"):
                    link.remove(visual)
    names: dict[tuple[Path, str | None], str] = {}
    assets: dict[str, bytes] = {}
    originals: dict[str, str] = {}
    missing: dict[str, None] = {}
    unreadable: dict[Path, str] = {}
    for link, shape, mesh in mesh_shapes(root):
        stated = mesh.get("filename", "")
        found = _found(stated, file, folder, packages)
        if found is None:
            link.remove(shape)
            missing[stated] = None
            continue
        key = (found, mesh.get("scale"))
        if key not in names:
            try:
                content = read_bytes(found, "mesh")
            except InvalidInput as error:
                link.remove(shape)
                unreadable[found] = f"Not readable: {error}"
                continue
            names[key] = _free_name(found, assets)
            assets[names[key]] = content
            originals[names[key]] = stated
        mesh.set("filename", names[key])
    return Meshes(assets, originals, [*_not_found(list(missing)), *unreadable.values()])


def mesh_shapes(root: ET.Element) -> Iterator[tuple[ET.Element, ET.Element, ET.Element]]:
    """Link, shape and mesh of every mesh shape; shapes may be removed during the iteration."""
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            if mesh is not None:
                yield link, shape, mesh


def _compiler(root: ET.Element) -> ET.Element:
    """The element of MuJoCo's settings, created if missing; it has to be the first."""
    extension = root.find("mujoco")
    if extension is None:
        extension = ET.Element("mujoco")
        root.insert(0, extension)
    compiler = extension.find("compiler")
    return ET.SubElement(extension, "compiler") if compiler is None else compiler


def _found(stated: str, file: Path, folder: Path, packages: Mapping[str, Path]) -> Path | None:
    """The mesh file, or ``None``; finally try the bare name, as MuJoCo does."""
    in_package = _IN_PACKAGE.fullmatch(stated)
    if in_package:
        package, rest = in_package[1], in_package[2]
        places = [folder / rest for folder in package_folders(package, file, packages)]
    else:
        plain = stated.removeprefix("file://")
        places = [file.parent / plain, folder / plain]
    places.append(folder / Path(stated).name)
    return next((p for p in places if os.path.lexists(p) and not p.is_dir()), None)


def _free_name(found: Path, assets: Mapping[str, bytes]) -> str:
    """The file's name, numbered if another mesh has it: MuJoCo names meshes by the stem."""
    taken = {Path(name).stem for name in assets}
    stem, count = found.stem, 1
    while stem in taken:
        count += 1
        stem = f"{found.stem}_{count}"
    return stem + found.suffix


def _not_found(missing: list[str]) -> list[str]:
    """A sentence for each package, and one for the other files."""
    by_package: dict[str, list[str]] = {}
    for stated in missing:
        in_package = _IN_PACKAGE.fullmatch(stated)
        by_package.setdefault(in_package[1] if in_package else "", []).append(stated)
    sentences = []
    for package, files in by_package.items():
        if package:
            count = f"{len(files)} mesh{'' if len(files) == 1 else 'es'}"
            sentences.append(
                f"Not found: {count} of the package {package!r}. Say where it is: "
                f"load_robot(..., packages={{{package!r}: folder}}), qp-twist new --package "
                f'{package}=folder, or in a task file [robot.packages] {package} = "folder".'
            )
        else:
            sentences.append(f"Not found: {listed('mesh', files)}.")
    return sentences
