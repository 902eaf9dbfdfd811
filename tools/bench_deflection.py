"""Benchmark of the deflection models on generated robots with concealed parameters.

python -m galen_hw.tools.bench_deflection --robots 20 --lstm 3 --write docs/deflection.md
"""

import argparse
import json
import resource
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from galen_hw.identification.deflection.compare import first_rest, residual_give
from galen_hw.identification.deflection.data import DeflectionSet
from galen_hw.identification.deflection.elastic import ElasticArm
from galen_hw.identification.deflection.linear import CoupledLinear
from galen_hw.identification.deflection.lstm import Lstm
from galen_hw.spatial import Array
from galen_hw.tools.deflection.robots import KINDS, NOISE_M, GivingRobot

if TYPE_CHECKING:
    from galen_hw.identification.deflection.model import DeflectionModel

BEGIN, END = "<!-- bench: written by galen_hw.tools.bench_deflection -->", "<!-- bench end -->"
LEARN, NEW, FIRST_NEW = 4, 2, 5
BAND_95: Final = 1.959964
SEEN_RESIDUAL_M: Final = 3e-5


def true_error(data: DeflectionSet, give: Array) -> Array:
    """(N, 3) predicted less true give, both from the first rest on."""
    true = np.stack([data.observations.columns[f"covariate.true.{a}"] for a in "xyz"], axis=1)
    rest = first_rest(data)
    return np.asarray(give - give[rest].mean(axis=0) - true + true[rest].mean(axis=0))


def tracked_error(data: DeflectionSet, give: Array) -> Array:
    """(N, 3) tracked less predicted give, both from the first rest on."""
    error = data.give - give
    return np.asarray(error - error[first_rest(data)].mean(axis=0))


def rms(error: Array) -> float:
    """Of one axis."""
    return float(np.sqrt(np.mean(error**2)))


def judge_robot(seed: int, *, with_lstm: bool) -> dict[str, Any]:
    """One robot: learn at four configurations, judge at two others."""
    robot = GivingRobot.drawn(seed)
    learn, new = robot.sets(LEARN), robot.sets(NEW, each=1, first=FIRST_NEW)
    out: dict[str, Any] = {"seed": seed, "present": robot.present, "tracked": {}, "true": {}, "residual": {}}
    arm = ElasticArm()
    rivals: dict[str, DeflectionModel] = {"elastic arm": arm, "coupled linear": CoupledLinear()}
    if with_lstm:
        rivals["LSTM (report)"] = Lstm()
    for name, model in rivals.items():
        begin, used = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF)
        model.fit(learn)
        after = resource.getrusage(resource.RUSAGE_SELF)
        if name == "elastic arm":
            out["fit_s"] = time.perf_counter() - begin
            out["fit_cpu_s"] = after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime
        gives = [model.predict(s) for s in new]
        out["tracked"][name] = rms(np.concatenate([tracked_error(s, g) for s, g in zip(new, gives, strict=True)]))
        out["true"][name] = rms(np.concatenate([true_error(s, g) for s, g in zip(new, gives, strict=True)]))
        pairs = np.concatenate([residual_give(s, g) for s, g in zip(new, gives, strict=True)])
        if rms(pairs[:, 0]) > SEEN_RESIDUAL_M:
            out["residual"][name] = rms(pairs[:, 0] - pairs[:, 1]) / rms(pairs[:, 0])
    out["give"] = rms(np.concatenate([tracked_error(s, np.zeros_like(s.give)) for s in new]))
    out["kept"] = {kind: kind in arm.kept for kind in KINDS}
    held = [(true_error(s, arm.predict(s)), tracked_error(s, arm.predict(s)), arm.variance(s)) for s in new]
    out["covers_true"] = float(np.mean(np.concatenate([np.abs(e) <= BAND_95 * np.sqrt(v) for e, _, v in held])))
    noisy = [np.abs(t) <= BAND_95 * np.sqrt(v + arm.noise**2) for _, t, v in held]
    out["covers_tracked"] = float(np.mean(np.concatenate(noisy)))
    return out


def table(results: list[dict[str, Any]]) -> str:
    """The figures as Markdown."""
    names = ("elastic arm", "coupled linear", "LSTM (report)")

    def over(key: str, name: str) -> Array:
        return np.array([r[key][name] for r in results if name in r[key]])

    lines = [
        f"{len(results)} generated robots, {LEARN} configurations x 2 sets to learn, {NEW} to judge; rms an axis.",
        "",
    ]
    lines += ["| at configurations never seen | " + " | ".join(names) + " |", "| --- | ---: | ---: | ---: |"]
    ours = over("tracked", names[0]) / NOISE_M

    def row(text: str, cells: list[str]) -> None:
        lines.append(f"| {text} | " + " | ".join(cells) + " |")

    row("robots", [str(len(over("tracked", n))) for n in names])
    row(
        "error of the tracked tip, x tracker noise: median (worst)",
        [_pair(over("tracked", n) / NOISE_M) for n in names],
    )
    row("error of the true tip, mm: median (worst)", [_pair(1e3 * over("true", n), 3) for n in names])
    row(
        "residual give after a release that is missed: median (worst)",
        [_pair(100 * over("residual", n), 0, " %") for n in names],
    )
    for text, key in (("true", "true"), ("tracked", "tracked")):
        ratios = [np.array([r[key][n] / r[key][names[0]] for r in results if n in r[key]]) for n in names]
        row(f"error of the {text} tip, times ours: median (least)", [_pair(q, 1, "", least=True) for q in ratios])
    right = [r["kept"][k] == r["present"][k] for r in results for k in KINDS]
    whole = [all(r["kept"][k] == r["present"][k] for k in KINDS) for r in results]
    residual = over("residual", names[0])
    lines += ["", "| what | wanted | found |", "| --- | --- | --- |"]
    row("held-out error, x tracker noise", ["<= 1.2", f"{np.mean(ours <= 1.2):.0%} of robots; worst {ours.max():.2f}"])
    row(
        "residual after a release, missed",
        ["<= 20 %", f"{np.mean(residual <= 0.2):.0%} of robots; median {np.median(residual):.0%}"],
    )
    row(
        "an effect kept or dropped rightly",
        [">= 95 %", f"{np.mean(right):.1%} of {len(right)}; all four at once {np.mean(whole):.0%}"],
    )
    for kind in KINDS:
        mine = [(r["present"][kind], r["kept"][kind]) for r in results]
        missed, extra = sum(p and not k for p, k in mine), sum(k and not p for p, k in mine)
        row(
            f"{kind}",
            ["", f"missed {missed} of {sum(p for p, _ in mine)}, invented {extra} of {sum(not p for p, _ in mine)}"],
        )
    for text, key in (("true tip", "covers_true"), ("tracked tip, tracker noise added", "covers_tracked")):
        row(f"95 % interval holds the {text}", ["93-97 %", f"{np.mean([r[key] for r in results]):.1%}"])
    cpu, wall = (np.array([r[k] for r in results]) for k in ("fit_cpu_s", "fit_s"))
    row(
        "fit of the elastic arm, 8 sets",
        ["<= 60 s", f"{np.median(cpu):.1f} s CPU, {np.median(wall):.1f} s on a shared machine"],
    )
    row("rms of the give itself, mm", ["", _pair(1e3 * np.array([r["give"] for r in results]), 2)])
    return "\n".join(lines)


def _pair(values: Array, digits: int = 2, unit: str = "", *, least: bool = False) -> str:
    if not len(values):
        return "-"
    other = values.min() if least else values.max()
    return f"{np.median(values):.{digits}f} ({other:.{digits}f}){unit}"


def main(argv: list[str] | None = None) -> int:
    """Run the robots; results are kept as lines of JSON, so that a run can be taken up again."""
    parser = argparse.ArgumentParser(description="deflection models on generated robots")
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--first", type=int, default=1000, help="first seed")
    parser.add_argument("--lstm", type=int, default=3, help="train the LSTM for so many of them")
    parser.add_argument("--results", type=Path, help="file of JSON lines to go on with")
    parser.add_argument("--write", type=Path, metavar="FILE.md", help="put the tables between the marks of this page")
    args = parser.parse_args(argv)
    results: list[dict[str, Any]] = []
    if args.results is not None and args.results.exists():
        results = [json.loads(line) for line in args.results.read_text(encoding="utf-8").splitlines()]
    done = {r["seed"] for r in results}
    for number in range(args.robots):
        seed = args.first + number
        if seed in done:
            continue
        results.append(judge_robot(seed, with_lstm=number < args.lstm))
        wrong = [k for k in KINDS if results[-1]["kept"][k] != results[-1]["present"][k]]
        ours = results[-1]["tracked"]["elastic arm"] / NOISE_M
        print(f"{seed}: {ours:.2f} x noise; wrong: {', '.join(wrong) or 'none'}", file=sys.stderr, flush=True)
        if args.results is not None:
            with args.results.open("a", encoding="utf-8") as file:
                file.write(json.dumps(results[-1]) + "\n")
    text = table(results)
    print(text)
    if args.write is not None:
        page = args.write.read_text(encoding="utf-8")
        before, after = page.partition(BEGIN)[0], page.partition(END)[2]
        args.write.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
