"""Closing the loop: the tool's file as what a diagnosis starts from, and what it found put back into it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.stats import trim_mean

from galen_hw.config.tool_file import Term, ToolFile, parse_tool
from galen_hw.errors import UsageError
from galen_hw.physics.effects.registry import effect_of
from galen_hw.physics.effects.terms import dated, is_dated, why_not_live
from galen_hw.recording import Recording
from galen_hw.recording.from_mcap import tool_info

if TYPE_CHECKING:
    from galen_hw.diagnosis.work import Work
    from galen_hw.physics.scenes.base import Scene
    from galen_hw.spatial import Array

TRIMMED: Final = 0.01
"""Share of rows at either end that do not count for a channel's offset: isolated outliers."""


def tool_named(given: str) -> ToolFile:
    """A tool of the store by its name, or from a file by its path.

    Raises:
        UsageError: no such tool, or its file is damaged.
    """
    from galen_hw.tools.tool import tool_store

    path = Path(given)
    if path.suffix != ".json" and not path.exists():
        return tool_store(None).load(given)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"cannot be read ({error})", where=f"--tool {given}", todo="galen-hw tool list") from None
    return parse_tool(text, str(path))


def with_tool(recording: Recording, tool: ToolFile) -> Recording:
    """The recording as if this tool had been in hand: what it says of its tool, zeroing and offsets is replaced.

    Raises:
        UsageError: the tool was never calibrated.
    """
    if not tool.calibrated:
        todo = f"galen-hw calibrate --tool {tool.name}"
        raise UsageError(f"tool {tool.name!r} was never calibrated", where="--tool", todo=todo)
    old = recording.info.model_dump(mode="json", by_alias=True, exclude_unset=True)
    new = tool_info(json.loads(tool.to_json()))
    model = old.get("model", {}) | new.pop("model")
    old = {k: v for k, v in old.items() if k not in ("tool", "bias_body", "zeroed_at")}
    info = type(recording.info).model_validate({"schema": 1} | old | new | {"model": model})
    return replace(recording, info=info, tool_file=tool.to_json())


@dataclass(frozen=True, slots=True)
class Saved:
    """What became of `--save-model`.

    Args:
        text: of the file; empty where there was nothing to save. lines: for the user.
    """

    text: str
    lines: tuple[str, ...]


def model_to_save(work: "Work", recording: Recording, target: Path) -> Saved:
    """The effects found, in the tool's file where there is one, else by themselves.

    A tool's file is complete: it holds what the old one held, the effects that can be served live, and the constant
    offset fitted again beside them. Everything that is left out is said.
    """
    if work.diagnosis.predict == "pose":
        return _arm_to_save(work, recording, target)
    group, named = work.diagnosis.predict, {finding.effect for finding in work.diagnosis.findings}
    found = [term for term in work.diagnosis.terms if term["effect"] in named]
    whole = bool(recording.tool_file) and group == "wrench"
    keep, lines = _servable(found, group, recording.epoch) if whole else ([*found], [])
    if not keep:
        why = "; ".join(lines) or "nothing was found"
        return Saved("", (f"{target} is not written: {why}",))
    names = ", ".join(dict.fromkeys(t["effect"] for t in keep))
    if not whole:
        values = {"schema": 1, "recording": work.diagnosis.recording, "group": group, "terms": keep}
        lines.append(f"{names} saved in {target} as terms alone; with --tool NAME it is a whole tool's file")
        return Saved(json.dumps(values, indent=1, ensure_ascii=False) + "\n", tuple(lines))
    tool = _extended(parse_tool(recording.tool_file, str(recording.path)), work, keep)
    lines.append(f"{tool.name} with {names} saved in {target}; galen-hw tool import {target} takes it up")
    return Saved(tool.to_json() + "\n", tuple(lines))


def _arm_to_save(work: "Work", recording: Recording, target: Path) -> Saved:
    """The give of the arm as a model of the deflection service."""
    from galen_hw.tools.diagnose_arm import deflection_file

    file, lines = deflection_file(work, recording)
    if file is None:
        why = "; ".join(lines) or "no give of the arm was found"
        return Saved("", (f"{target} is not written: {why}",))
    lines.append(f"deflection model {file.name} saved in {target}; galen-hw deflection import {target} takes it up")
    return Saved(json.dumps(file.model_dump(mode="json", by_alias=True), indent=1) + "\n", tuple(lines))


def _servable(
    terms: Sequence[Mapping[str, Any]], group: str, epoch: float | None
) -> tuple[list[dict[str, Any]], list[str]]:
    """The terms that the live services can add, dated, and one line for each kind that they cannot."""
    keep, left = [], {}
    for term in terms:
        key = term["effect"]
        why = why_not_live(term, group)
        if not why and is_dated(term) and epoch is None:
            why = "the recording does not say when it was made"
        if why:
            left[key] = f"{key} is left out, {why}"
        elif key != "bias":  # the tool's own constant offset holds it
            keep.append(dated(term, epoch or 0.0))
    return keep, list(left.values())


def _extended(tool: ToolFile, work: "Work", keep: Sequence[Mapping[str, Any]]) -> ToolFile:
    """The tool's file with further terms and the offset that goes with them."""
    name = Path(work.diagnosis.recording).name
    scene = work.bench.scene
    offset = offset_of(scene, work.diagnosis.terms)
    terms = [Term(effect=t["effect"], parameters=t["parameters"], source=f"diagnosis of {name}") for t in keep]
    names = ", ".join(dict.fromkeys(t.effect for t in terms))
    rows = [i for i, p in enumerate(tool.parameters) if not p.startswith("bias.")]
    remark = f"{names} added and the offset fitted again from {name}"
    origin = tool.origin and tool.origin.model_copy(update={"remarks": (*tool.origin.remarks, remark)})
    changed = {
        "bias": tuple(float(f"{x:.9g}") for x in offset),
        "bias_std": None,
        "parameters": tuple(tool.parameters[i] for i in rows),
        "covariance": tuple(tuple(tool.covariance[i][j] for j in rows) for i in rows),
        "terms": (*tool.terms, *terms),
        "origin": origin,
    }
    return ToolFile.model_validate(tool.model_copy(update=changed).model_dump(by_alias=True))


def offset_of(scene: "Scene", terms: Sequence[Mapping[str, Any]]) -> "Array":
    """(C,) constant that is left of the residual beside the effects found, on the recording's own clock."""
    rest = scene.residual.copy()
    for term in terms:
        if term["effect"] != "bias":
            effect = effect_of(term)
            rest -= effect.change(scene, effect.theta_of(scene, term["parameters"]))
    return np.asarray(trim_mean(rest, TRIMMED, axis=0))
