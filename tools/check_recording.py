"""`galen-hw check RECORDING`: what the premises say of a recording, before anything is fitted to it."""

import sys
from pathlib import Path
from typing import Any

from galen_hw.errors import GalenError
from galen_hw.formats.own import expanded
from galen_hw.tools.answer import print_stamped


def check_recordings(paths: list[Path], *, as_json: bool) -> int:
    """Ask all premises of each recording, or of each in a folder of them; print what they say.

    Returns:
        0 if nothing forbids a fit, 1 if a premise refuses a recording, 2 if one cannot be read.
    """
    answers, status = [], 0
    for path in [inside for given in paths for inside in expanded(given)]:
        try:
            answer = _asked(path)
        except GalenError as error:
            print(f"galen-hw check: {error}", file=sys.stderr)
            status = 2
            continue
        answers.append(answer)
        status = max(status, int(any(p["action"] == "refused" for p in answer["premises"])))
        if not as_json:
            print("\n".join(_lines(answer)))
    if as_json:
        print_stamped({"recordings": answers})
    return status


def _asked(path: Path) -> dict[str, Any]:
    """What is said of one recording.

    Raises:
        GalenError: it cannot be read, or its model is no machine's.
    """
    from galen_hw.formats import read
    from galen_hw.premises import examined
    from galen_hw.recording.observations import named_in, observations_of

    recording = read(path)
    with named_in(recording):
        seen = observations_of(recording)
        found = examined(seen)
    return {
        "recording": str(path),
        "predict": seen.predict,
        "rows": len(seen),
        "premises": [r.to_json() for r in found.remarks],
        "lines": [r.line for r in found.remarks],
    }


def _lines(answer: dict[str, Any]) -> list[str]:
    head = f"{answer['recording']}: {answer['rows']} rows, {answer['predict']} compared"
    said = [f"  {p['action']:9} {line}" for p, line in zip(answer["premises"], answer["lines"], strict=True)]
    return [head, *(said or ["  ok        nothing that was looked for is wrong with it"])]
