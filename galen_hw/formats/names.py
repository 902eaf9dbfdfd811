"""What a column of a foreign file is called, and which column of ours that may be."""

import re
import unicodedata
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from galen_hw.formats.contents import Stream
from galen_hw.formats.units import factor, split_unit
from galen_hw.recording.recording import FIXED_COLUMNS, JOINT_KINDS, group_of, joint_column

_REWORKED: Final = re.compile(r"_(raw|filt(?:ered)?|comp(?:ensated)?|zeroed|smooth(?:ed)?|est(?:imated)?)$")
SURE, LIKELY, WEAK = 3, 2, 1
"""Told by the file or by our own name; by a usual name; by a name that may be something else."""
LESSER: Final = re.compile(
    r"filt|/comp|compens|zero|desired|target|setpoint|command|_ref|bias|smooth|est", re.IGNORECASE
)
"""Of two streams that fit, one that is so called is not the raw one."""


@dataclass(frozen=True)
class Match:
    """A column that may be one of ours.

    Args:
        target: our column; stream, column: of the file; unit: as the file or the name says, else empty (SI).
        weight: how sure, see above; source: columns of one vector or one robot belong together by it.
    """

    target: str
    stream: str
    column: str
    unit: str
    weight: float
    source: str

    @property
    def family(self) -> str:
        """What is chosen as a whole: the force, the torque, the joints' positions, ..."""
        joint = joint_column(self.target)
        if joint:
            return f"joint.*.{joint[1]}"
        return self.target.rpartition(".")[0] or self.target


def quantity_of(target: str) -> str:
    """The quantity of a column of ours, a key of `units.ALLOWED`."""
    if target == "time":
        return "time"
    joint = joint_column(target)
    if joint:
        return f"joint {'position' if joint[1] == 'command' else joint[1]}"
    for start, quantity in _QUANTITIES.items():
        if target.startswith(start):
            return quantity
    return "position" if group_of(target) == "targets" else "one"


_QUANTITIES: Final = {
    "wrench.force": "force",
    "wrench.torque": "torque",
    "applied.force": "force",
    "pose.position": "position",
    "imu.acceleration": "acceleration",
    "imu.angular_velocity": "angular velocity",
    "temperature.": "temperature",
}
_VECTORS: Final[tuple[tuple[str, str, float], ...]] = (
    # ends of names, in lower case with "_" for every separator; what comes before tells vectors of one kind apart
    ("wrench.force", r"(?:force|ft_f|f)_?([xyz])", LIKELY),
    ("wrench.torque", r"(?:torque|moment|ft_[tm])_?([xyz])", LIKELY),
    ("wrench.torque", r"(?:m|t|tau)_?([xyz])", WEAK),
    ("pose.position", r"(?:position|translation|pos|trans|xyz)_?([xyz])", LIKELY),
    ("pose.position", r"(?:p|t)_?([xyz])", WEAK),
    ("pose.orientation", r"(?:orientation|rotation|quaternion|quat|rot)_?([xyzw])", LIKELY),
    ("pose.orientation", r"q_?([xyzw0])", LIKELY),
    ("imu.acceleration", r"(?:linear_)?(?:acceleration|accel|acc)_?([xyz])", LIKELY),
    ("imu.acceleration", r"a_?([xyz])", WEAK),
    ("imu.angular_velocity", r"(?:angular_velocity|gyro|omega)_?([xyz])", LIKELY),
    ("imu.angular_velocity", r"(?:w|g)_?([xyz])", WEAK),
)
_KINDS: Final = {
    "position": r"actual_q|joint_positions?|joint_angles?|positions?|pos|angles?|q",
    "velocity": r"actual_qd|joint_velocit(?:y|ies)|velocit(?:y|ies)|vel|q_?dot|dq|qd",
    "effort": r"joint_torques?|joint_efforts?|efforts?|torques?|tau_j|tau|trq",
    "command": r"target_q|q_d|q_des(?:ired)?|q_cmd|q_ref|commands?|setpoints?|desired_positions?",
}
_INDEXED: Final = {kind: re.compile(rf"(?:(.*?)_)?(?:{words})_?(\d+)$") for kind, words in _KINDS.items()}
_JOINT_FIRST: Final = {kind: re.compile(rf"(?:joint|j|axis)_?(\d+)_(?:{words})$") for kind, words in _KINDS.items()}
_JOINT_ALONE: Final = re.compile(r"(?:joint|axis|j)_?(\d+)$")
_NAMED: Final = re.compile(rf"(?P<kind>{'|'.join(_KINDS.values())})\[(?P<name>.+)\]$")
_LISTED: Final = re.compile(r"joints?\[(?P<name>.+)\]\.(?P<kind>position|velocity|effort)$")
_TEMPERATURE: Final = re.compile(r"(?:temperature|temp)(?:_(.+))?$|(.+)_(?:temperature|temp)$")


_ENGLISH: Final = {
    "force": ("kraft", "fuerza", "forza"),
    "torque": ("moment", "drehmoment", "couple", "momento", "coppia", "par"),
    "time": ("zeit", "zeitstempel", "temps", "tiempo", "tempo"),
    "joint": ("gelenk", "articulation", "articulacion", "articulacao", "giunto", "junta"),
    "axis": ("achse", "axe", "eje", "asse", "eixo"),
    "joint_angle": ("gelenkwinkel",),
    "joint_torque": ("gelenkmoment",),
    "angle": ("winkel", "angulo", "angolo"),
    "velocity": ("geschwindigkeit", "vitesse", "velocidad", "velocidade", "velocita"),
    "acceleration": ("beschleunigung", "aceleracion", "accelerazione"),
    "temperature": ("temperatur", "temperatura"),
}
"""Words of German, French, Spanish, Italian and Portuguese, without accents."""
_FOREIGN: Final = {word: english for english, words in _ENGLISH.items() for word in words}
_WORDS: Final = re.compile(rf"(?<![a-z])({'|'.join(sorted(_FOREIGN, key=len, reverse=True))})(?=[xyz]?(?:_|\d|$))")


def plain(name: str) -> str:
    """In lower case, every separator an underscore, without accents, usual words of other languages in English."""
    bare = unicodedata.normalize("NFKD", name)
    bare = "".join(c for c in bare if not unicodedata.combining(c))
    bare = re.sub(r"[^a-z0-9]+", "_", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", bare).lower()).strip("_")
    return _WORDS.sub(lambda found: _FOREIGN[found[1]], bare)


def matches(stream: Stream) -> list[Match]:
    """Every column of a stream that may be one of ours."""
    found = [match for column in stream.columns for match in _of_column(stream, column)]
    return list(_settled(found))


def _of_column(stream: Stream, column: str) -> Iterator[Match]:
    name, unit = split_unit(column)
    unit = stream.units.get(column, unit)

    def match(target: str, weight: float, source: str = "") -> Match:
        lesser = 0.5 if LESSER.search(f"{stream.name} {source}") else 0.0
        return Match(target, stream.name, column, unit, weight - lesser, f"{stream.name}:{source}")

    if column in stream.hints:
        yield match(stream.hints[column], SURE + 1)
    elif _ours(column):
        yield match(column, SURE)
    elif joint := _NAMED.match(name) or _LISTED.match(name):
        kind, one = (joint["kind"], joint["name"])
        named = f"joint_{one}" if one.isdigit() else one
        yield match(f"joint.{named}.{_kind(kind)}", SURE)
    else:
        bare, _, how = _REWORKED.sub(r"/\1", plain(name)).partition("/")
        yield from (match(target, weight, f"{source}/{how}") for target, weight, source in _by_name(bare))


def _kind(word: str) -> str:
    return next(kind for kind, words in _KINDS.items() if re.fullmatch(words, word))


def _ours(column: str) -> bool:
    group = group_of(column)
    return (
        (column in FIXED_COLUMNS and column != "time")
        or (group not in (None, "covariate"))
        or column.startswith("covariate.")
    )


def _by_name(name: str) -> Iterator[tuple[str, float, str]]:
    for kind in JOINT_KINDS:
        if found := _INDEXED[kind].fullmatch(name):
            yield f"joint.joint_{int(found[2])}.{kind}", LIKELY, found[1] or ""
        elif found := _JOINT_FIRST[kind].fullmatch(name):
            yield f"joint.joint_{int(found[1])}.{kind}", LIKELY, ""
    if found := _JOINT_ALONE.fullmatch(name):
        yield f"joint.joint_{int(found[1])}.position", LIKELY, ""
    for target, end, weight in _VECTORS:
        if found := re.fullmatch(rf"(?:(.*)_)?{end}", name):
            yield f"{target}.{found[2].replace('0', 'w')}", weight, f"{found[1] or ''}/{end}"
    if name in ("x", "y", "z"):
        yield f"pose.position.{name}", WEAK, "xyz"
    if found := _TEMPERATURE.fullmatch(name):
        yield f"temperature.{found[1] or found[2] or 'ambient'}", LIKELY, name


def _settled(found: list[Match]) -> Iterator[Match]:
    """Only whole vectors; a column in two roles has the one in which its whole vector stands."""
    by_source: dict[tuple[str, str], list[Match]] = defaultdict(list)
    for match in found:
        by_source[match.family, match.source].append(match)
    whole = {key: group for key, group in by_source.items() if _complete(key[0], group)}
    taken: dict[str, float] = {}
    has_force = any(key[0] == "wrench.force" for key in whole)
    has_turn = any(key[0] == "pose.orientation" for key in whole)
    for (family, _), group in sorted(whole.items(), key=lambda item: -item[1][0].weight):
        weak = group[0].weight < LIKELY - 0.5
        # "tx" is a torque beside forces and a translation beside a quaternion; beside both it must be said.
        if weak and family == "wrench.torque" and not has_force:
            continue
        if weak and family == "pose.position" and not has_turn and group[0].column.lower() not in ("x", "y", "z"):
            continue
        if weak and family.startswith("imu"):
            continue
        if any(taken.get(m.column, -1.0) > m.weight for m in group):
            continue
        taken |= {m.column: m.weight for m in group}
        yield from group


def _complete(family: str, group: list[Match]) -> bool:
    axes = {match.target.rpartition(".")[2] for match in group}
    if group[0].weight >= SURE - 0.5 or family.partition(".")[0] in ("joint", "temperature", "covariate"):
        return True
    return axes >= (set("xyzw") if family.endswith("orientation") else set("xyz"))


def fits(match: Match) -> bool:
    """Return whether the unit that the file gives is one of what the column is taken for."""
    return not match.unit or factor(match.unit, quantity_of(match.target)) is not None


def chosen(found: Iterable[Match]) -> tuple[list[Match], dict[str, list[str]]]:
    """The matches of the surest source of each family, and families with several that are as sure (by source)."""
    families: dict[str, dict[str, list[Match]]] = defaultdict(lambda: defaultdict(list))
    for match in found:
        if fits(match):
            families[match.family][match.source].append(match)
    best: list[Match] = []
    doubtful: dict[str, list[str]] = {}
    for family, sources in families.items():
        weight = max(group[0].weight for group in sources.values())
        surest = [group for group in sources.values() if group[0].weight == weight]
        if len({match.target for group in surest for match in group}) == sum(map(len, surest)):
            best += [match for group in surest for match in group]  # different joints or places of one kind
        else:
            doubtful[family] = [f"{group[0].stream or 'table'}: {group[0].column}" for group in surest]
    return best, doubtful
