"""Find the mesh files of a URDF, and report missing ones."""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

from qp_twist.checks import clause
from qp_twist.errors import InvalidInput
from qp_twist.files import is_folder, read_bytes
from qp_twist.robots.mesh_files import coloured_meshes, msh
from qp_twist.robots.ros_packages import how_to_state, package_folders
from qp_twist.robots.urdf_visuals import Visual, materials_of, visual_of
from qp_twist.robots.wording import free_name, listed

_IN_PACKAGE = re.compile(r"(?:package|model)://([^/]+)/(.+)")


class Meshes(NamedTuple):
    """The meshes of a file."""

    assets: dict[str, bytes]
    """Their contents, by their new names in the tree."""
    stated: dict[str, str]
    """Their names in the file, by the same new names."""
    left_out: list[str]
    visuals: list[Visual]
    """Visual shapes that are not in the tree any more."""


def take_meshes(root: ET.Element, file: Path, packages: Mapping[str, Path]) -> Meshes:
    """Read the mesh files of a URDF; remove shapes whose mesh is not found.

    The tree gets short names, one for each file and scale, since MuJoCo's reader identifies files
    by name; DAE files are converted. Visual shapes are removed from the tree, since MuJoCo would
    draw them without the colours of their files, and returned, unless there are no others or the
    file says ``<mujoco><compiler discardvisual="false"/></mujoco>``; with ``"true"`` they are left
    out.
    """
    compiler = _compiler(root)
    folder = file.parent / compiler.attrib.pop("meshdir", "")
    for attribute in ("assetdir", "strippath"):
        compiler.attrib.pop(attribute, None)
    missing: dict[str, None] = {}
    visuals: list[Visual] = []
    if compiler.get("discardvisual") != "false":
        if root.find("link/collision") is None:
            compiler.set("discardvisual", "false")
        else:
            visuals = _taken_visuals(
                root, lambda stated: _found(stated, file, folder, packages), missing
            )
            if compiler.get("discardvisual") == "true":
                visuals, missing = [], {}
    names: dict[tuple[Path, str | None], str] = {}
    assets: dict[str, bytes] = {}
    originals: dict[str, str] = {}
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
                if found.suffix.lower() == ".dae":
                    content = _from_dae(found, shape)
            except InvalidInput as error:
                link.remove(shape)
                unreadable[found] = f"Not readable: {error}"
                continue
            suffix = ".msh" if found.suffix.lower() == ".dae" else found.suffix
            # MuJoCo names meshes by the stem.
            names[key] = free_name(found.stem, {Path(name).stem for name in assets}) + suffix
            assets[names[key]] = content
            originals[names[key]] = stated
        mesh.set("filename", names[key])
    return Meshes(
        assets,
        originals,
        [*_not_found(list(missing), file, packages), *unreadable.values()],
        visuals,
    )


def _taken_visuals(
    root: ET.Element, found_at: Callable[[str], Path | None], missing: dict[str, None]
) -> list[Visual]:
    """Remove the visual shapes from the tree and return them; missing files are noted."""
    materials = materials_of(root)
    visuals = []
    for link in root.findall("link"):
        for shape in link.findall("visual"):
            link.remove(shape)
            mesh = shape.find("geometry/mesh")
            stated = "" if mesh is None else mesh.get("filename", "")
            file = found_at(stated) if mesh is not None else None
            if mesh is not None and file is None:
                missing[stated] = None
            elif visual := visual_of(link, shape, materials, file):
                visuals.append(visual)
    return visuals


def _from_dae(file: Path, shape: ET.Element) -> bytes:
    """A DAE file as MuJoCo reads it; a visual shape without a material gets its largest colour."""
    try:
        meshes = coloured_meshes(file)
    except InvalidInput as error:
        raise InvalidInput(f"{file.name}: {clause(error)}.") from error
    colour = meshes[0].colour
    if shape.tag == "visual" and shape.find("material") is None and colour is not None:
        material = ET.SubElement(shape, "material", name=f"colour of {file.name}")
        ET.SubElement(material, "color", rgba=" ".join(map(str, colour)))
    return msh(meshes)


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
    """The mesh file, or ``None``; finally try the bare name, as MuJoCo does.

    Files made on other systems have backslashes, blanks as ``%20``, and names in another case.
    """
    plain = unquote(stated.strip().replace("\\", "/"))
    places = list(_places(stated, file, folder, packages))
    if plain != stated:
        places += _places(plain, file, folder, packages)
    there = (p for p in places if os.path.lexists(p) and not is_folder(p))
    in_other_case = (found for p in places if (found := _in_other_case(p)) is not None)
    return next(there, None) or next(in_other_case, None)


def _places(stated: str, file: Path, folder: Path, packages: Mapping[str, Path]) -> Iterator[Path]:
    """Where a mesh may be, the most likely first."""
    in_package = _IN_PACKAGE.fullmatch(stated)
    if in_package:
        package, rest = in_package[1], in_package[2]
        yield from (folder / rest for folder in package_folders(package, file, packages))
    else:
        plain = stated.removeprefix("file://")
        yield from (file.parent / plain, folder / plain)
    yield folder / Path(stated).name


def _in_other_case(place: Path) -> Path | None:
    """The only file whose path differs from ``place`` in upper and lower case alone, if any."""
    found = Path(place.anchor)
    for name in place.relative_to(place.anchor).parts:
        if not os.path.lexists(found / name):
            try:
                alike = [p.name for p in found.iterdir() if p.name.casefold() == name.casefold()]
            except OSError:
                return None
            if len(alike) != 1:
                return None
            [name] = alike  # noqa: PLW2901
        found /= name
    return None if is_folder(found) else found


def _not_found(missing: list[str], file: Path, packages: Mapping[str, Path]) -> list[str]:
    """A sentence for each package, and one for the other files."""
    by_package: dict[str, list[str]] = {}
    for stated in missing:
        in_package = _IN_PACKAGE.fullmatch(stated)
        by_package.setdefault(in_package[1] if in_package else "", []).append(stated)
    sentences = []
    for package, files in by_package.items():
        folders = package_folders(package, file, packages) if package else iter(())
        known = next((folder for folder in folders if is_folder(folder)), None)
        if known is not None:
            sentences.append(
                f"Not found in the package {package!r} ({known}): {listed('mesh', files)}."
            )
        elif package:
            count = f"{len(files)} mesh{'' if len(files) == 1 else 'es'}"
            sentences.append(
                f"Not found: {count} of the package {package!r}. {how_to_state(package)}"
            )
        else:
            sentences.append(f"Not found: {listed('mesh', files)}.")
    return sentences
