"""What a URDF has to be seen: the visuals of its links."""

from collections.abc import Iterator
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float

from kanejax._errors import ModelFileError
from kanejax._io.xml_text import numbers_of, text_of
from kanejax._view.files import MeshFolders
from kanejax._view.mesh_files import mesh_surfaces
from kanejax._view.shape import GREY, Rgb, Surface, box, cylinder, ellipsoid

# What one link may have: mesh files of others are read one by one.
_MOST_VISUALS = 1000


def urdf_shapes(robot: ElementTree.Element, folders: MeshFolders) -> tuple[list[tuple[str, Surface]], list[str]]:
    """The surfaces of a <robot>, each with its link's name and in its axes, and in sentences what could not be read."""
    found: list[tuple[str, Surface]] = []
    problems: list[str] = []
    materials: dict[str, tuple[Rgb, float]] = {}
    for material in robot.findall("material"):
        name = material.get("name", "")
        try:
            materials |= {name: look} if (look := _rgba(material, {}, "it")) else {}
        except ModelFileError as error:
            problems.append(f"material {name!r}: {error}")
    for link in robot.findall("link"):
        name = link.get("name", "")
        for visual in link.findall("visual")[:_MOST_VISUALS]:
            try:
                found += [(name, each) for each in _visual(visual, materials, folders, "a visual")]
            except ModelFileError as error:
                problems.append(f"link {name!r}: {error}")
    return found, problems


def _visual(
    visual: ElementTree.Element, materials: dict[str, tuple[Rgb, float]], folders: MeshFolders, owner: str
) -> Iterator[Surface]:
    geometry = visual.find("geometry")
    children = [] if geometry is None else list(geometry)
    if not children:
        raise ModelFileError(f"{owner} has no geometry")
    material = visual.find("material")
    look = None if material is None else _rgba(material, materials, owner)
    color, opacity = look or (None, 1.0)
    rotation, position = _origin(visual.find("origin"), owner)
    for each in _geometry(children[0], color, folders, owner):
        yield each._replace(opacity=opacity).moved(rotation, position)


def _geometry(shape: ElementTree.Element, color: Rgb | None, folders: MeshFolders, owner: str) -> tuple[Surface, ...]:
    look = {"color": color or GREY}
    if shape.tag == "box":
        return (box(_positive(shape, "size", 3, owner), **look),)
    if shape.tag == "sphere":
        return (ellipsoid(np.repeat(_positive(shape, "radius", 1, owner), 3), **look),)
    if shape.tag == "cylinder":
        radius, length = (float(_positive(shape, key, 1, owner)[0]) for key in ("radius", "length"))
        return (cylinder(radius, length, **look),)
    if shape.tag == "mesh":
        path = folders.file(text_of(shape, "filename", owner))
        scale = np.array(numbers_of(shape, "scale", 3, owner)) if shape.get("scale") else np.ones(3)
        return mesh_surfaces(path, np.diag(scale), np.zeros(3), color)
    raise ModelFileError(f"{owner} is a <{shape.tag}>, which is not drawn")


def _positive(shape: ElementTree.Element, attribute: str, count: int, owner: str) -> Float[np.ndarray, " n"]:
    numbers = np.array(numbers_of(shape, attribute, count, owner))
    if not np.all((numbers > 0) & (numbers < 1e9)):
        raise ModelFileError(f"{owner}: <{shape.tag} {attribute}={shape.get(attribute)!r}> is no size; give positive lengths")
    return numbers


def _origin(element: ElementTree.Element | None, owner: str) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    from scipy.spatial.transform import Rotation

    if element is None:
        return np.eye(3), np.zeros(3)
    rpy, position = (
        np.array(numbers_of(element, key, 3, owner)) if element.get(key) is not None else np.zeros(3) for key in ("rpy", "xyz")
    )
    return Rotation.from_euler("xyz", rpy).as_matrix(), position


def _rgba(material: ElementTree.Element, named: dict[str, tuple[Rgb, float]], owner: str) -> tuple[Rgb, float] | None:
    """Colour and opacity of a <material>; those of its name if it has none itself."""
    color = material.find("color")
    if color is None:
        return named.get(material.get("name", ""))
    red, green, blue, alpha = np.clip(numbers_of(color, "rgba", 4, owner), 0.0, 1.0)
    return (float(red), float(green), float(blue)), float(alpha)
