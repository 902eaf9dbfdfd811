"""The page of the benchmarks: ratios of pairs, and lines that are measured again one by one."""

import numpy as np

from galen_hw.tools.benchmarks.__main__ import _lines, _page, _ratios
from galen_hw.tools.benchmarks.floor import Floor


def test_the_median_of_the_pairs_counts() -> None:
    """One pair of which the machine took a half decides nothing; each daemon is held against the bare processes beside it."""
    bare = [Floor(np.full(100, level), 0.03) for level in (100.0, 200.0, 100.0)]
    ours = [{"p50_us": p50, "p99_us": 140.0} for p50 in (120.0, 250.0, 900.0)]
    row = _ratios("what", bare, ours, "bench")

    assert row.good
    assert "p50 1.25 x (1.20-9.00; 250 us over 100 us)" in row.measured
    assert not _ratios("what", bare, [{"p50_us": 300.0, "p99_us": 140.0}] * 3, "bench").good


def test_a_line_that_is_measured_again_replaces_its_own() -> None:
    """All others stay as they are, in their places."""
    page = _page(["| a | < 1 | 0.5 | yes | x |", "| b | < 1 | 2 | **no** | y |"])
    lines = _lines(page)
    assert list(lines) == ["a", "b"]
    lines["a"] = "| a | < 1 | 0.7 | yes | x |"

    assert _page(lines.values()) == page.replace("0.5", "0.7")
