"""Benchmark of the deflection models on generated robots with concealed parameters.

python -m galen_hw.tools.benchmarks.deflection --robots 20 --results bench.jsonl --write docs/deflection.md
"""

import argparse
import json
import resource
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from galen_hw.identification.deflection.compare import counted, judged, residual_give, wall_shares
from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.identification.deflection.elastic import ElasticArm
from galen_hw.identification.deflection.table import MODELS, model_class
from galen_hw.spatial import Array
from galen_hw.tools.deflection.robots import KINDS, NOISE_M, GivingRobot

BEGIN, END = "<!-- bench: written by galen_hw.tools.benchmarks.deflection -->", "<!-- bench end -->"
OURS: Final = "elastic arm"
RIVALS: Final = ("coupled linear", "LSTM (report)")
NEW, SAME, OTHER = "new configuration", "same configuration", "other day"
LEARN, JUDGE, FIRST_NEW = 4, 2, 5
BAND_95: Final = 1.959964
SEEN_RESIDUAL_M: Final = 3e-5
FRESH: Final = 8000
"""First of the robots that nobody looked at while the model was built; those from 4000, 6000 and 7000 on were."""


def true_give(data: DeflectionSet) -> Array:
    """(N, 3) true tip, counted from the rests; the tracker's noise and delay are not in it."""
    true = np.stack([data.observations.columns[f"covariate.true.{a}"] for a in "xyz"], axis=1)
    return counted(data, true)


def errors(pairs: Iterable[tuple[DeflectionSet, Array]]) -> Array:
    """(K, 3) of values (N, 3) of sets, counted from the rests, on the rows that count."""
    return np.concatenate([counted(s, values)[judged(s)] for s, values in pairs])


def rms(error: Array) -> float:
    """Of one axis."""
    return float(np.sqrt(np.mean(error**2)))


def judge_robot(seed: int, names: list[str]) -> dict[str, Any]:
    """One robot: learn at four configurations twice each; judge there again, at two others, and on another day."""
    robot = GivingRobot.drawn(seed)
    learn = robot.sets(LEARN)
    held = {
        SAME: robot.sets(JUDGE, each=1, again=2),
        NEW: robot.sets(JUDGE, each=1, first=FIRST_NEW),
        OTHER: robot.sets(JUDGE, each=1, day=1),
    }
    out: dict[str, Any] = {"seed": seed, "present": robot.present, "models": {}}
    out["give"] = rms(errors((s, true_give(s)) for s in held[NEW]))
    out["largest"] = float(max(np.linalg.norm(true_give(s), axis=1).max() for s in held[NEW]))
    for name in names:
        model = model_class(name)()
        begin, used = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF)
        model.fit(learn)
        after = resource.getrusage(resource.RUSAGE_SELF)
        cpu = after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime
        gives = {kind: [model.predict(s) for s in sets] for kind, sets in held.items()}
        out["models"][name] = {"fit_s": time.perf_counter() - begin, "fit_cpu_s": cpu} | _errors(held, gives)
        if isinstance(model, ElasticArm):
            out["kept"] = {kind: kind in model.kept for kind in KINDS}
            out |= _coverage(model, held[NEW], gives[NEW])
    return out


def _errors(held: dict[str, list[DeflectionSet]], gives: dict[str, list[Array]]) -> dict[str, Any]:
    """Of one model: rms against the tracked and the true tip, share of residual give missed, time beyond walls."""
    out: dict[str, Any] = {"tracked": {}, "true": {}}
    for kind, sets in held.items():
        pairs = list(zip(sets, gives[kind], strict=True))
        out["tracked"][kind] = rms(errors((s, s.give[:, :3] - g[:, :3]) for s, g in pairs))
        out["true"][kind] = rms(errors((s, true_give(s) - g[:, :3]) for s, g in pairs))
    pairs = list(zip(held[NEW], gives[NEW], strict=True))
    # Against the true tip: beside a residual of 0.03 mm the tracker's noise alone would be a quarter of it.
    left = np.concatenate([residual_give(replace(s, give=true_give(s)), g) for s, g in pairs])
    if rms(left[:, 0]) > SEEN_RESIDUAL_M:
        out["residual"] = rms(left[:, 0] - left[:, 1]) / rms(left[:, 0])
    shares = [wall_shares(replace(s, give=true_give(s)), g) for s, g in pairs]
    out["walls"] = np.mean(shares, axis=0).tolist()
    return out


def _coverage(arm: ElasticArm, sets: list[DeflectionSet], gives: list[Array]) -> dict[str, float]:
    """Shares of coordinates inside the 95 % interval, of the true tip and of the tracked one."""
    true, tracked = [], []
    for s, g in zip(sets, gives, strict=True):
        variance = arm.variance(s)[judged(s), :3]
        true.append(np.abs(errors([(s, true_give(s) - g[:, :3])])) <= BAND_95 * np.sqrt(variance))
        band = BAND_95 * np.sqrt(variance + arm.noise[:3] ** 2)
        tracked.append(np.abs(errors([(s, s.give[:, :3] - g[:, :3])])) <= band)
    return {
        "covers_true": float(np.mean(np.concatenate(true))),
        "covers_tracked": float(np.mean(np.concatenate(tracked))),
    }


def of_model(results: list[dict[str, Any]], name: str, *keys: str) -> Array:
    """One figure of a model over all robots that have it."""
    out = []
    for r in results:
        value: Any = r["models"].get(name, {})
        for key in keys:
            value = value.get(key) if isinstance(value, dict) else None
        if value is not None and not isinstance(value, dict):
            out.append(value)
    return np.array(out)


def text_of(results: list[dict[str, Any]]) -> str:
    """The figures as Markdown."""
    names = [n for n in MODELS if any(n in r["models"] for r in results)]
    give, largest = (1e3 * np.array([r[k] for r in results]) for k in ("give", "largest"))
    about = f"{len(results)} generated robots, {LEARN} configurations x 2 sets to learn, {JUDGE} held-out sets of each kind; "
    about += "rms an axis; median (worst) over robots. "
    about += f"The tip gives {np.median(give):.2f} mm rms ({give.min():.2f} to {give.max():.2f}), "
    about += f"at most {np.median(largest):.1f} mm ({largest.min():.1f} to {largest.max():.1f})."
    lines = [
        about,
        "",
        "| error of the tracked tip, x tracker noise | same configuration | new configuration | other day |",
        "| --- | ---: | ---: | ---: |",
    ]
    for name in names:
        cells = [pair(of_model(results, name, "tracked", kind) / NOISE_M) for kind in (SAME, NEW, OTHER)]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    head = ("error of the true tip, mm", "residual after a release, missed", "time beyond a wall", "fit, s of CPU")
    lines += ["", "| at new configurations | " + " | ".join(head) + " |", "| --- | ---: | ---: | ---: | ---: |"]
    for name in names:
        walls = np.array([r["models"][name]["walls"] for r in results if name in r["models"]])
        cells = [
            pair(1e3 * of_model(results, name, "true", NEW), 3),
            pair(100 * of_model(results, name, "residual"), 0, " %"),
            f"{100 * walls[:, 1].mean():.1f} %",
            pair(of_model(results, name, "fit_cpu_s"), 1),
        ]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    reported = np.mean([r["models"][OURS]["walls"][0] for r in results])
    lines.append(f"| reported pose (rigid) | {pair(give, 3)} | | {100 * reported:.1f} % | |")
    return "\n".join([*lines, "", "| what | wanted | found |", "| --- | --- | --- |", *verdicts(results)])


def verdicts(results: list[dict[str, Any]]) -> list[str]:
    """Rows of the table of what was wanted and what was found."""
    ours, residual = of_model(results, OURS, "tracked", NEW) / NOISE_M, of_model(results, OURS, "residual")
    rows = [
        ("held-out error, x tracker noise", "<= 1.2", f"{np.mean(ours <= 1.2):.0%} of robots; worst {ours.max():.2f}"),
    ]
    for rival in RIVALS:
        both = [r["models"] for r in results if rival in r["models"]]
        for tip in ("tracked", "true"):
            ratio = np.array([m[rival][tip][NEW] / m[OURS][tip][NEW] for m in both])
            if len(ratio):
                found = f"{np.mean(ratio >= 5.0):.0%} of {len(ratio)} robots; median {np.median(ratio):.1f}"
                rows.append(
                    (f"{rival}, error of the {tip} tip, times ours", ">= 5", f"{found}, least {ratio.min():.1f}")
                )
    share = f"{np.mean(residual <= 0.2):.0%} of {len(residual)} robots that have one; median {np.median(residual):.0%}"
    rows.append(("residual after a release, missed", "<= 20 %", f"{share}, worst {residual.max():.0%}"))
    right = [r["kept"][k] == r["present"][k] for r in results for k in KINDS]
    whole = [all(r["kept"][k] == r["present"][k] for k in KINDS) for r in results]
    found = f"{np.mean(right):.1%} of {len(right)}; all four at once in {np.mean(whole):.0%} of robots"
    rows.append(("an effect kept or dropped rightly", ">= 95 %", found))
    for kind in KINDS:
        mine = [(r["present"][kind], r["kept"][kind]) for r in results]
        missed, extra = sum(p and not k for p, k in mine), sum(k and not p for p, k in mine)
        there = sum(p for p, _ in mine)
        rows.append((kind, "", f"missed {missed} of {there}, invented {extra} of {len(mine) - there}"))
    for what, key in (("true tip", "covers_true"), ("tracked tip, tracker noise added", "covers_tracked")):
        each = np.array([r[key] for r in results])
        rows.append(
            (f"95 % interval holds the {what}", "93-97 %", f"{each.mean():.1%} ({each.min():.0%} to {each.max():.0%})")
        )
    others = [n for n in MODELS if not n.startswith("LSTM")]
    cpu, wall = (
        np.array([sum(r["models"][n][key] for n in others if n in r["models"]) for r in results])
        for key in ("fit_cpu_s", "fit_s")
    )
    found = f"{pair(cpu, 1)} s of CPU; {pair(wall, 1)} s on a shared machine"
    rows.append((f"fit of all models but the LSTM, {2 * LEARN} sets", "<= 60 s", found))
    return [f"| {' | '.join(r)} |" for r in rows]


def pair(values: Array, digits: int = 2, unit: str = "") -> str:
    """Median and, in brackets, the largest."""
    return f"{np.median(values):.{digits}f} ({values.max():.{digits}f}){unit}" if len(values) else "-"


def main(argv: list[str] | None = None) -> int:
    """Run the robots; results are kept as lines of JSON, so that a run can be taken up again."""
    parser = argparse.ArgumentParser(description="deflection models on generated robots")
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--first", type=int, default=FRESH, help="first seed")
    parser.add_argument("--without", nargs="*", default=[], choices=list(MODELS), help="leave models out")
    parser.add_argument("--results", type=Path, help="file of JSON lines to go on with")
    parser.add_argument("--write", type=Path, metavar="FILE.md", help="put the tables between the marks of this page")
    args = parser.parse_args(argv)
    results: list[dict[str, Any]] = []
    if args.results is not None and args.results.exists():
        results = [json.loads(line) for line in args.results.read_text(encoding="utf-8").splitlines()]
    done = {r["seed"] for r in results}
    names = [n for n in MODELS if n not in args.without]
    for seed in range(args.first, args.first + args.robots):
        if seed in done:
            continue
        results.append(judge_robot(seed, names))
        wrong = [k for k in KINDS if results[-1]["kept"][k] != results[-1]["present"][k]]
        ours = results[-1]["models"][OURS]["tracked"][NEW] / NOISE_M
        print(f"{seed}: {ours:.2f} x noise; wrong: {', '.join(wrong) or 'none'}", file=sys.stderr, flush=True)
        if args.results is not None:
            with args.results.open("a", encoding="utf-8") as file:
                file.write(json.dumps(results[-1]) + "\n")
    text = text_of(results)
    print(text)
    if args.write is not None:
        page = args.write.read_text(encoding="utf-8")
        before, after = page.partition(BEGIN)[0], page.partition(END)[2]
        args.write.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
