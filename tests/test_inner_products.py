"""Inner products that are learnt when they are asked for are those of the whole matrix, whatever was asked before."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from galen_hw.diagnosis.estimation.inner_products import Group, InnerProducts
from galen_hw.diagnosis.stats.sampling import Index
from galen_hw.spatial import Array

ROWS, WIDTH = 12, 3
STEPS = st.lists(st.sampled_from(["append", "ask", "ask all", "for a while", "forget"]), min_size=1, max_size=12)


def _group(rng: np.random.Generator) -> tuple[Group, Array]:
    """A group of columns, some of them zero in some channels, and the same as (rows x channels, k)."""
    size = int(rng.integers(0, 4))
    whole, columns = np.zeros((WIDTH, ROWS, size)), {}
    for c in range(WIDTH):
        at = np.flatnonzero(rng.random(size) < 0.6)
        if len(at):
            whole[c][:, at] = rng.normal(size=(ROWS, len(at)))
            columns[c] = (at, whole[c][:, at])
    return Group(size, columns), whole.reshape(WIDTH * ROWS, size)


def _check(products: InnerProducts, X: Array, a: Index, b: Index) -> None:
    assert np.allclose(products.between(a, b), X[:, a].T @ X[:, b], atol=1e-12)


@settings(deadline=None)
@given(STEPS, st.integers(0, 2**32 - 1))
def test_products_are_those_of_the_whole_matrix(steps: list[str], seed: int) -> None:
    """In any order of growing and asking; what came for a while or is forgotten leaves no trace."""
    rng = np.random.default_rng(seed)
    products, X, sizes = InnerProducts(WIDTH), np.empty((WIDTH * ROWS, 0)), list[int]()

    def grow() -> Array:
        new = [_group(rng) for _ in range(int(rng.integers(1, 4)))]
        first = len(products)
        sizes.extend(group.size for group, _ in new)
        products.append([group for group, _ in new])
        whole = np.concatenate([X, *(columns for _, columns in new)], axis=1)
        target = rng.normal(size=(WIDTH, ROWS, 2))
        said = products.with_targets(list(target), first)
        assert np.allclose(said, whole[:, first:].T @ target.reshape(WIDTH * ROWS, 2), atol=1e-12)
        return whole

    def some() -> Index:
        return np.flatnonzero(rng.random(len(products)) < 0.3)

    for step in steps:
        if step == "append":
            X = grow()
        elif step == "forget":
            gone = rng.random(len(sizes)) < 0.4
            left = products.forget(gone)
            assert (left == ~np.repeat(gone, sizes)).all()
            X, sizes = X[:, left], [size for size, out in zip(sizes, gone, strict=True) if not out]
            assert len(products) == X.shape[1]
            _check(products, X, some(), some())
        elif step == "for a while":
            before = list(sizes)
            with products.fewer_again():
                more = grow()
                _check(products, more, some(), some())
                _check(products, more, some(), np.arange(len(products)))
            sizes = before
        else:
            at = some()
            _check(products, X, at, np.arange(len(products)) if step == "ask all" else at)
    assert len(products) == X.shape[1]
    _check(products, X, some(), some())
