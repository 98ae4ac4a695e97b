"""A robot from a URDF file: yourdfpy reads it, and what it lets pass unsaid is checked here."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, TreeBuilder, tostring
from xml.parsers import expat

from clikgen.runtime.documents import BadInput, choices
from clikgen.symbolic.robot import Joint, Mimic, Vector

TYPES = ("fixed", "prismatic", "revolute", "continuous")
PARTS = ("parent", "child", "origin", "axis", "limit", "mimic")  # of a joint, as far as motion goes

# element and attribute of a joint -> how many numbers it holds
NUMBERS = {
    ("origin", "xyz"): 3,
    ("origin", "rpy"): 3,
    ("axis", "xyz"): 3,
    ("limit", "lower"): 1,
    ("limit", "upper"): 1,
    ("limit", "velocity"): 1,
    ("mimic", "multiplier"): 1,
    ("mimic", "offset"): 1,
}


@dataclass(frozen=True, slots=True)
class UrdfModel:
    """What a URDF says of the robot's motion: its root link, the joints depth first in the file's order, notes."""

    root: str
    joints: tuple[Joint, ...]
    notes: tuple[str, ...]


def read_urdf(path: Path) -> UrdfModel:
    """The tree of joints in the URDF file `path`; raises BadInput, one line, when it is not a sound one.

    Link and joint names stay as they are. Meshes, masses, efforts and transmissions are not looked at.
    """
    try:
        xml = _parse(_content(path))
        _refuse_xacro(xml, path.name)
        _check_names(xml)
        _check_numbers(xml)
        return _model(xml, path.parent)
    except BadInput as error:
        raise BadInput(" ".join(f"{path}: {error}".split())) from None


def _content(path: Path) -> bytes:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadInput(f"cannot be read: {error.strerror}") from None
    if not content.strip():
        raise BadInput("the file is empty, wanted a URDF: <robot> with links and joints")
    return content


def _parse(content: bytes) -> Element:
    """The <robot> element, read without namespaces: URDFs use prefixes (drake:, gazebo:) they never declare."""
    builder, parser = TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise BadInput(f"not valid XML: {error}") from None
    xml: Element = builder.close()
    if xml.tag != "robot":
        raise BadInput(f"not a URDF: wanted <robot> as the outermost element, got <{xml.tag}>")
    return xml


def _refuse_xacro(xml: Element, name: str) -> None:
    how = f"expand it first: xacro {name} > expanded.urdf"
    for element in xml.iter():
        if element.tag.startswith("xacro:"):
            raise BadInput(f"<{element.tag}> is a xacro macro, wanted a URDF; {how}")
    for element in (part for tag in ("link", "joint") for top in xml.findall(tag) for part in top.iter()):
        for key, value in element.items():
            if "${" in value or "$(" in value:
                raise BadInput(f"<{element.tag}> {key}='{value}' is xacro, wanted a URDF; {how}")


def _check_names(xml: Element) -> None:
    """Links and joints have names of their own; a joint has a type we know, a parent and a child that are there."""
    links, joints = _names(xml, "link"), _names(xml, "joint")
    if not links:
        raise BadInput("<robot> has no <link>, wanted links and joints")
    carried: dict[str, str] = {}  # link -> the joint that carries it
    for name, joint in zip(joints, xml.findall("joint"), strict=True):
        _check_type(name, joint.get("type"))
        for end in ("parent", "child"):
            link = _end(joint, end)
            if link is None:
                raise BadInput(f"joint '{name}': wanted <{end} link='...'/>, got none; {choices('', links)}")
            if link not in links:
                raise BadInput(f"joint '{name}': <{end}>: no link '{link}'; {choices(link, links)}")
        child = str(_end(joint, "child"))
        if child in carried:
            raise BadInput(f"link '{child}' has two parents, by joints '{carried[child]}' and '{name}'; wanted one")
        carried[child] = name


def _names(xml: Element, tag: str) -> list[str]:
    names: list[str] = []
    for element in xml.findall(tag):
        name = element.get("name")
        if not name:
            raise BadInput(f"<{tag}> number {len(names) + 1} has no name, wanted <{tag} name='...'>")
        if name in names:
            raise BadInput(f"{tag} '{name}' is there twice, wanted every name once")
        names.append(name)
    return names


def _check_type(name: str, kind: str | None) -> None:
    if kind in ("floating", "planar"):
        raise BadInput(
            f"joint '{name}' is {kind}, which has no coordinate of its own here; valid choices: {', '.join(TYPES)} "
            "(a moving base is not in the URDF but in the spec: base = 'holonomic' or 'differential')"
        )
    if kind not in TYPES:
        got = f"unknown type '{kind}'" if kind else "no type"
        raise BadInput(f"joint '{name}' has {got}; {choices(kind or '', TYPES)}")


def _end(joint: Element, tag: str) -> str | None:
    element = joint.find(tag)
    return None if element is None else element.get("link")


def _check_numbers(xml: Element) -> None:
    for joint in xml.findall("joint"):
        name = joint.get("name")
        for (tag, attribute), count in NUMBERS.items():
            element = joint.find(tag)
            text = None if element is None else element.get(attribute)
            if text is not None and not _are_numbers(text, count):
                wanted = "a finite number" if count == 1 else f"{count} finite numbers"
                raise BadInput(f"joint '{name}': <{tag}> {attribute}: wanted {wanted}, got '{text}'")
        origin = joint.find("origin")
        if origin is not None and "quat_xyzw" in origin.attrib:
            raise BadInput(f"joint '{name}': <origin> quat_xyzw is not read, wanted rpy='roll pitch yaw' [rad]")


def _are_numbers(text: str, count: int) -> bool:
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        return False
    return len(numbers) == count and all(map(math.isfinite, numbers))


def _model(xml: Element, folder: Path) -> UrdfModel:
    parsed = _read_joints(xml)
    links = _names(xml, "link")
    root, order = _depth_first(links, parsed)
    types = {joint.name: joint.type for joint in parsed}
    follows = {joint.name: joint.mimic for joint in parsed if joint.mimic and joint.type != "fixed"}
    angles = _angles(xml)
    joints = tuple(_joint(joint, angles[joint.name], _mimic(joint.name, types, follows)) for joint in order)
    still = [joint.name for joint in order if joint.type != "fixed" and joint.limit and joint.limit.velocity == 0]
    notes = [f"velocity limit 0 of {_listed('joint', still)} read as none"] if still else []
    return UrdfModel(root, joints, (*notes, *_missing_meshes(xml, folder)))


def _read_joints(xml: Element) -> list[Any]:
    """The joints as yourdfpy reads them, given no more of the file than what it says of motion."""
    from yourdfpy import URDF  # here, not above: it takes seconds, and most controllers have no URDF

    skeleton = Element("robot", name="robot")
    for joint in xml.findall("joint"):
        copy = SubElement(skeleton, "joint", _plain(joint))
        for part in joint:
            if part.tag in PARTS:
                SubElement(copy, part.tag, _plain(part))
    model = URDF.load(BytesIO(tostring(skeleton)), build_scene_graph=False, load_meshes=False)
    return list(model.robot.joints)


def _plain(element: Element) -> dict[str, str]:
    """The attributes but for those with a prefix (drake:acceleration), which may be declared nowhere."""
    return {key: value for key, value in element.items() if ":" not in key}


def _depth_first(links: Sequence[str], joints: Sequence[Any]) -> tuple[str, list[Any]]:
    """The root link, and the joints each after the one that carries it, in the file's order where that is free."""
    behind: dict[str, list[Any]] = {link: [] for link in links}
    for joint in joints:
        behind[joint.parent].append(joint)
    children = {joint.child for joint in joints}
    roots = [link for link in links if link not in children]
    if len(roots) > 1:
        raise BadInput(f"wanted one root link, got {len(roots)} that no joint carries: {', '.join(roots)}")
    order: list[Any] = []
    ahead = list(reversed(behind[roots[0]])) if roots else []
    while ahead:
        order.append(ahead.pop())
        ahead += reversed(behind[order[-1].child])
    reached = {joint.name for joint in order}
    lost = [joint.name for joint in joints if joint.name not in reached]
    if lost:
        raise BadInput(f"no root link carries {_listed('joint', lost)}: a ring, wanted a tree")
    return roots[0], order


def _joint(parsed: Any, rpy: Vector, mimic: Mimic | None) -> Joint:
    """Our joint from yourdfpy's; `rpy` as the file has it, for yourdfpy turns the angles into a matrix."""
    common: dict[str, Any] = {
        "name": parsed.name,
        "type": parsed.type,
        "link": parsed.child,
        "parent": parsed.parent,
        "xyz": (0.0, 0.0, 0.0) if parsed.origin is None else tuple(parsed.origin[:3, 3].tolist()),
        "rpy": rpy,
    }
    if parsed.type != "fixed":
        velocity = parsed.limit.velocity if parsed.limit else None
        if velocity is not None and velocity < 0:
            raise BadInput(f"joint '{parsed.name}': <limit> velocity: wanted at least 0, got {velocity:g}")
        common |= {"axis": _unit_axis(parsed), "velocity": velocity or None, "mimic": mimic}
    if parsed.type in ("prismatic", "revolute"):
        common |= dict(zip(("lower", "upper"), _limits(parsed), strict=True))
    return Joint.parse(common, f"joint '{parsed.name}'")


def _angles(xml: Element) -> dict[str, Vector]:
    """Joint -> the roll, pitch and yaw of its origin [rad]."""
    angles: dict[str, Vector] = {}
    for joint in xml.findall("joint"):
        origin = joint.find("origin")
        text = "0 0 0" if origin is None else origin.get("rpy", "0 0 0")
        roll, pitch, yaw = (float(word) for word in text.split())
        angles[joint.get("name", "")] = roll, pitch, yaw
    return angles


def _unit_axis(joint: Any) -> Vector:
    x, y, z = joint.axis.tolist()
    length = math.hypot(x, y, z)
    if length == 0:
        raise BadInput(f"joint '{joint.name}': <axis> xyz: wanted a direction, got '0 0 0'")
    return (x, y, z) if length == 1 else (x / length, y / length, z / length)


def _limits(joint: Any) -> tuple[float, float]:
    """Lower and upper limit; one of the two that is absent is 0, as the URDF format has it."""
    limit = joint.limit
    if limit is None or (limit.lower, limit.upper) == (None, None):
        without = "; without limits it is of type continuous" if joint.type == "revolute" else ""
        raise BadInput(f"joint '{joint.name}' is {joint.type}: wanted <limit> lower and upper, got none{without}")
    lower, upper = limit.lower or 0.0, limit.upper or 0.0
    if lower > upper:
        raise BadInput(f"joint '{joint.name}': <limit>: wanted lower <= upper, got {lower:g} and {upper:g}")
    return lower, upper


def _mimic(name: str, types: Mapping[str, str], follows: Mapping[str, Any]) -> Mimic | None:
    """What the joint follows in the end: of q = a p + b and p = c r + d comes q = a c r + (a d + b)."""
    if name not in follows:
        return None
    valid = [joint for joint, kind in types.items() if kind != "fixed" and joint not in follows]
    multiplier, offset, chain = 1.0, 0.0, [name]
    while chain[-1] in follows:
        mimic = follows[chain[-1]]
        multiplier, offset = multiplier * mimic.multiplier, multiplier * mimic.offset + offset
        if mimic.joint in chain:
            ring = " -> ".join([*chain, mimic.joint])
            raise BadInput(f"joint '{name}' mimics itself: {ring}; {choices(mimic.joint, valid)}")
        if types.get(mimic.joint, "fixed") == "fixed":
            wrong = f"'{mimic.joint}', which is fixed" if mimic.joint in types else f"no joint '{mimic.joint or ''}'"
            raise BadInput(f"joint '{chain[-1]}': <mimic>: {wrong}; {choices(mimic.joint or '', valid)}")
        chain.append(mimic.joint)
    return Mimic(joint=chain[-1], multiplier=multiplier, offset=offset)


def _missing_meshes(xml: Element, folder: Path) -> list[str]:
    """One note for the mesh files that are not where the file says; other addresses (package://) are not tried."""
    missing = [
        (name, link.get("name"))
        for link in xml.findall("link")
        for mesh in link.iter("mesh")
        if "://" not in (name := mesh.get("filename", "").removeprefix("file://")) and not (folder / name).is_file()
    ]
    if not missing:
        return []
    (name, link), others = missing[0], len(set(missing)) - 1
    more = f" (and {others} more)" if others else ""
    return [f"mesh '{name}' of link '{link}'{more} not found: not needed for the controller, drawn without"]


def _listed(kind: str, names: Iterable[str]) -> str:
    quoted = [f"'{name}'" for name in names]
    return f"{kind}{'s' if len(quoted) > 1 else ''} {', '.join(quoted)}"
