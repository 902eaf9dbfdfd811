"""docs/proof.md and its figures: failures first, then every promised figure beside what was reached."""

from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from galen_hw.tools.blind_proof import seal, sections, tables
from galen_hw.tools.blind_proof.generator.case import SNR_LEVELS
from galen_hw.tools.blind_proof.score import Scored

PREAMBLE = """Written by `make proof`; nothing here is edited by hand. The generator (MuJoCo) shares no code with the
tool; the truth stayed sealed until every verdict was on disk.
"""
ALIKE = """A lag and a delay do the same to first order. How far a lag is from the best of all delays, and a delay from the
best of all lags, for one who knows what else is there, is known with the truth; within 3.3 standard errors any answer to
"which of the two" is a guess.
"""


def _origin(seed: int, commit: str) -> str:
    """Return where the set is from: of the commit's own seed, or of one that was given to compare two engines on one set."""
    if seed == seal.seed_of(commit):
        return f"seed {seed} (commit {commit})"
    return f"seed {seed}, given, so that engines can be compared on one set; answered by commit {commit}"


def write(
    path: Path,
    cases: list[Scored],
    rivals: list[dict[str, Any]],
    recordings: list[str],
    *,
    seed: int,
    commit: str,
    planned: int | None = None,
) -> list[str]:
    """Write the report and its figures, of all recordings or of those that were judged in time.

    Returns the promised figures that were missed, a line each.
    """
    pictures = path.parent / "proof"
    pictures.mkdir(parents=True, exist_ok=True)
    promised = tables.figures(cases, rivals)
    parts = [
        "# The blind proof\n",
        PREAMBLE,
        ALIKE if any(e.get("apart") is not None for c in cases for e in c.truth["effects"]) else "",
        f"{_count(len(cases), planned)}, {_origin(seed, commit)}.\n",
        _failures(cases),
        _promises(promised),
        _power(cases, pictures),
        _confusion(cases, pictures),
        _where_and_how_much(cases, pictures),
        _rival_table(rivals, {c.truth["name"]: c for c in cases}, pictures),
        "\n".join(recordings),
    ]
    # The section that another command writes stays.
    parts.append(sections.kept(path, sections.MISTAKES))
    path.write_text("\n".join(p for p in parts if p))
    return [f"{f.what}: promised {f.promised}, reached {f.reached}" for f in promised if not f.good]


def _count(judged: int, planned: int | None) -> str:
    if planned is None or planned == judged:
        return f"{judged} recordings"
    return f"{judged} of {planned} recordings, taken in mixed order until the time that was given was over"


def _failures(cases: list[Scored]) -> str:
    wrong = [c for c in cases if not c.right]
    text = [f"## Failures first\n\n{len(wrong)} of {len(cases)} cases were not answered rightly.\n"]
    for share in ("null", "premise", "outside", "single", "several"):
        some = [c for c in wrong if c.truth["share"] == share]
        strong = [c for c in some if share != "single" or (c.truth["effects"][0]["snr"] or 9) >= 0.4]
        if some:
            weak = f", of them {len(some) - len(strong)} below SNR 0.4, not listed" if len(strong) < len(some) else ""
            text.append(f"**{share}** ({len(some)}{weak})\n")
            text += [f"- {c.truth['name']}: {c.why}{_beside(c)}" for c in strong]
            text.append("")
    return "\n".join(text)


def _beside(case: Scored) -> str:
    """What made a case hard."""
    mask = f", {case.truth['mask']}" if case.truth["mask"] else ""
    return mask + "".join(f", {apart:.1f} standard errors from its look-alike" for apart in case.near)


def _promises(promised: list[tables.Figure]) -> str:
    rows = [f"| {f.what} | {f.promised} | {f.reached} | {'yes' if f.good else '**no**'} |" for f in promised]
    return "\n".join(
        ["## Promised and reached\n", "| what | promised | reached | |", "| --- | --- | --- | --- |", *rows, ""]
    )


def _power(cases: list[Scored], pictures: Path) -> str:
    rows = tables.power(cases)
    head = "| effect | " + " | ".join(f"SNR {s}" for s in SNR_LEVELS) + " |"
    lines = ["## Power: right effect first (detected at all) of n\n", head, "| --- |" + " --- |" * len(SNR_LEVELS)]
    for key, levels in rows.items():
        cells = [f"{levels[s][1]} ({levels[s][0]}) of {levels[s][2]}" if s in levels else "" for s in SNR_LEVELS]
        lines.append(f"| {key} | " + " | ".join(cells) + " |")
    total = np.array([[levels.get(s, (0, 0, 0)) for s in SNR_LEVELS] for levels in rows.values()]).sum(axis=0)
    figure, ax = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    for column, label, colour in ((0, "something is there", "#8c8c8c"), (1, "right effect first", "#0b6e99")):
        ax.plot(SNR_LEVELS, total[:, column] / np.maximum(total[:, 2], 1), "o-", color=colour, label=label)
    ax.set(xscale="log", xlabel="rms effect / rms noise of one sample", ylabel="share of cases", ylim=(0, 1.02))
    ax.set_xticks(SNR_LEVELS, [str(s) for s in SNR_LEVELS])
    ax.minorticks_off()
    ax.grid(alpha=0.3)
    ax.legend(frameon=False)
    figure.savefig(pictures / "power.png", dpi=160)
    plt.close(figure)
    return "\n".join([*lines, "", "![power](proof/power.png)", ""])


def _confusion(cases: list[Scored], pictures: Path) -> str:
    counts = tables.confusion(cases)
    names = [*sorted({k for pair in counts for k in pair} - {"nothing", "unknown"}), "unknown", "nothing"]
    matrix = np.array([[counts[(a, b)] for b in names] for a in names[:-2]], dtype=float)
    if not matrix.size:
        return ""
    figure, ax = plt.subplots(figsize=(9, 7.6), layout="constrained")
    share = matrix / np.maximum(matrix.sum(axis=1, keepdims=True), 1)
    ax.imshow(share, cmap="Blues", vmin=0, vmax=1)
    for i, j in np.argwhere(matrix > 0):
        ink = "white" if share[i, j] > 0.5 else "black"
        ax.text(j, i, f"{int(matrix[i, j])}", ha="center", va="center", fontsize=7, color=ink)
    ax.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=8)
    ax.set_yticks(range(len(names) - 2), names[:-2], fontsize=8)
    ax.set(xlabel="called first", ylabel="concealed (SNR >= 0.4)")
    figure.savefig(pictures / "confusion.png", dpi=160)
    plt.close(figure)
    return "## Confusion\n\n![confusion](proof/confusion.png)\n"


def _where_and_how_much(cases: list[Scored], pictures: Path) -> str:
    rows = tables.parameter_rows(cases)
    lines = ["## Where and how much\n", f"- channels named by right findings: F1 {tables.channel_f1(cases):.2f}"]
    onsets = tables.onset_errors(cases)
    if onsets:
        lines.append(f"- moment of a step: median error {np.median(onsets):.2f} s over {len(onsets)} cases")
    seconds = [c.seconds for c in cases]
    lines.append(f"- time for one diagnosis: median {np.median(seconds):.1f} s, longest {max(seconds):.1f} s\n")
    if rows:
        _draw_parameters(rows, pictures / "parameters.png")
        lines.append("![parameters](proof/parameters.png)\n")
    return "\n".join(lines)


def _draw_parameters(rows: list[tables.ParameterRow], path: Path) -> None:
    """A line per parameter found, by effect, the surest first; those whose interval misses the truth stand out."""
    ordered = sorted(rows, key=lambda r: (r.effect, r.name, r.std / abs(r.true)))
    figure, ax = plt.subplots(figsize=(6.4, 0.8 + 0.15 * len(ordered)), layout="constrained")
    for holds, label, colour in ((True, "holds the truth", "#0b6e99"), (False, "misses it", "#c8501e")):
        some = [(y, r) for y, r in enumerate(ordered) if r.holds is holds]
        ax.errorbar(
            [abs(r.found / r.true) for _, r in some], [y for y, _ in some], xerr=[1.96 * r.std / abs(r.true) for _, r in some],
            fmt="o", ms=3, lw=1.0, color=colour, label=f"95 % interval {label} ({len(some)})",
        )  # fmt: skip
    names = [f"{r.effect}: {r.name}" for r in ordered]
    firsts = [k for k, name in enumerate(names) if k == 0 or names[k - 1] != name]
    for k in firsts[1:]:
        ax.axhline(k - 0.5, color="0.85", lw=0.6, zorder=0)
    middles = [(a + b - 1) / 2 for a, b in zip(firsts, [*firsts[1:], len(names)], strict=True)]
    ax.set_yticks(middles, [names[k] for k in firsts], fontsize=8)
    ax.tick_params(axis="y", length=0)
    ax.axvline(1.0, color="k", lw=0.8)
    ax.set(xlim=(0, 2), ylim=(len(ordered) - 0.4, -0.6), xlabel="found / true, a line per case")
    figure.legend(fontsize=8, ncols=2, frameon=False, loc="outside upper center")
    figure.savefig(path, dpi=160)
    plt.close(figure)


def _rival_table(rivals: list[dict[str, Any]], cases: dict[str, Scored], pictures: Path) -> str:
    if not rivals:
        return ""
    names = [n for n in rivals[0] if n not in tables.OWN]
    lines = [
        "## Rivals on the same held-out runs\n",
        "Held-out error over the error of the true formula (1 is perfect), on the rows that the tool is judged on.\n",
        "All begin from the same simulation, of the recorded joints.\n",
    ]
    lines += ["| | median | 90 % | beaten by the tool in |", "| --- | --- | --- | --- |"]
    tool = np.array([r["tool"] for r in rivals])
    lines.append(f"| galen-hw | {np.median(tool):.3f} | {np.quantile(tool, 0.9):.3f} | |")
    alone = np.array([r["named"] for r in rivals])
    lines.append(
        f"| galen-hw, named physics alone | {np.median(alone):.3f} | {np.quantile(alone, 0.9):.3f} "
        f"| {np.mean(tool < alone):.2f} of {len(alone)} |"
    )
    for n in names:
        v = np.array([r[n] for r in rivals])
        lines.append(f"| {n} | {np.median(v):.3f} | {np.quantile(v, 0.9):.3f} | {np.mean(tool < v):.2f} of {len(v)} |")
    lost = [(r, n) for r in rivals for n in [tables.best_rival(r)] if r["tool"] >= r[n]]
    lines += ["", "Not beaten:", ""] if lost else []
    lines += [f"- {r['name']}: {n} {r[n]:.4f}, galen-hw {r['tool']:.4f}; {cases[r['name']].why}" for r, n in lost]
    figure, ax = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    for n in ["tool", *names]:
        v = np.sort([r[n] for r in rivals])
        ax.plot(v, np.linspace(0, 1, len(v)), lw=2.2 if n == "tool" else 1.2, label="galen-hw" if n == "tool" else n)
    ax.set(xlim=(0.95, 2.0), xlabel="held-out error / error of the true formula", ylabel="share of cases")
    ax.grid(alpha=0.3)
    ax.legend(frameon=False)
    figure.savefig(pictures / "rivals.png", dpi=160)
    plt.close(figure)
    return "\n".join([*lines, "", "![rivals](proof/rivals.png)", ""])
