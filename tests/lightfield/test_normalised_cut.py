"""Normalised cuts against every cut there is, on graphs small enough to try them all."""

from itertools import combinations

import numpy as np
import pytest
import scipy.sparse

from pipelines.artifacts.arrays import FloatArray
from pipelines.lightfield import normalised_cut
from pipelines.lightfield.normalised_cut import divide_graph


def cliques(sizes: list[int], bridge: float) -> FloatArray:
    """Complete graphs in a row, each joined to the next by one weak edge."""
    total = sum(sizes)
    weights, start = np.zeros((total, total)), 0
    for size in sizes:
        weights[start : start + size, start : start + size] = 1.0
        if start:
            weights[start - 1, start] = weights[start, start - 1] = bridge
        start += size
    np.fill_diagonal(weights, 0.0)
    return weights


def cost(weights: FloatArray, side: list[int]) -> float:
    """By the definition of Shi and Malik."""
    inside = np.isin(np.arange(len(weights)), side)
    cut = weights[inside][:, ~inside].sum()
    return float(cut / weights[inside].sum() + cut / weights[~inside].sum())


def test_the_first_cut_is_the_best_of_all() -> None:
    weights = cliques([5, 4], 0.2)
    halves = divide_graph(scipy.sparse.csr_array(weights), 8, 2, 0.0)
    every = (list(c) for n in range(2, 8) for c in combinations(range(9), n))
    best = min(every, key=lambda side: cost(weights, side))
    assert sorted(best) in [half.tolist() for half in halves]
    assert [half.tolist() for half in halves] == [[0, 1, 2, 3, 4], [5, 6, 7, 8]]


def test_parts_keep_to_the_bound_and_hold_every_node_once() -> None:
    random = np.random.default_rng(3)
    places = random.uniform(0.0, 1.0, (120, 2))
    distance = np.linalg.norm(places[:, None] - places, axis=2)
    weights = np.where(distance < 0.2, np.exp(-5.0 * distance), 0.0)
    np.fill_diagonal(weights, 0.0)
    parts = divide_graph(scipy.sparse.csr_array(weights), 30, 5, 0.0)
    assert sorted(np.concatenate(parts).tolist()) == list(range(120))
    assert max(map(len, parts)) <= 30


def test_a_natural_seam_divides_what_is_small_enough() -> None:
    weights = scipy.sparse.csr_array(cliques([6, 6], 0.2))
    assert len(divide_graph(weights, 100, 2, 0.0)) == 1
    assert [len(part) for part in divide_graph(weights, 100, 2, 0.1)] == [6, 6]


def test_what_is_not_connected_is_never_one_part() -> None:
    weights = scipy.sparse.csr_array(cliques([4, 3], 0.0))
    parts = divide_graph(weights, 100, 2, 0.0)
    assert [part.tolist() for part in parts] == [[0, 1, 2, 3], [4, 5, 6]]


def test_iteration_finds_the_same_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    weights = scipy.sparse.csr_array(cliques([9, 7, 8, 11], 0.3))
    dense = divide_graph(weights, 12, 3, 0.0)
    monkeypatch.setattr(normalised_cut, "DENSE_NODES", 4)
    sparse = divide_graph(weights, 12, 3, 0.0)
    assert [p.tolist() for p in sparse] == [p.tolist() for p in dense]
    assert sorted(map(len, dense)) == [7, 8, 9, 11]
