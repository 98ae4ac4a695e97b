"""Copies as loops: the same entries from the same places, each once, and few loops where the places are even."""

from hypothesis import given
from hypothesis import strategies as st

from clikgen.symbolic.copies import Grid, Level, grids, moved


def carried_out(grid):
    """What loops over the grid copy, (to, source) each."""
    pairs = [(grid.to, grid.source)]
    for level in grid.levels:
        pairs = [(to + k * level.to, source + k * level.source) for to, source in pairs for k in range(level.times)]
    return pairs


pieces = st.lists(st.tuples(st.integers(0, 60), st.integers(0, 60), st.integers(-3, 9), st.integers(1, 12)), max_size=8)


@given(pieces)
def test_every_entry_is_copied_once_from_where_it_lies(pieces):
    """Runs of any stride, begun anywhere: what is written last stays, so each entry is in one of them."""
    places = {start + k: source + 40 + k * stride for start, source, stride, count in pieces for k in range(count)}
    found = grids(sorted(places.items()))
    copied = [pair for grid in found for pair in carried_out(grid)]
    assert len(copied) == len(places)
    assert dict(copied) == places
    assert sorted(index for grid in found for index in grid.filled) == sorted(places)


def test_points_of_one_link_among_others_are_one_grid():
    """Two of every six points, ten entries of a Jacobian each, of an array that holds them entry by entry."""
    pairs = [
        ((6 * pair + point) * 10 + entry, entry * 40 + 2 * pair + point)
        for pair in range(20)
        for point in range(2)
        for entry in range(10)
    ]
    assert grids(pairs) == [Grid(0, 0, (Level(20, 60, 2), Level(2, 10, 1), Level(10, 1, 40)))]


def test_an_index_is_written_without_what_does_nothing():
    assert moved(0, []) == "0"
    assert moved(0, [("k1", 1)]) == "k1"
    assert moved(3, [("k1", 10), ("k2", 0), ("k3", 1)]) == "3 + k1 * 10 + k3"
    assert moved(9, [("k1", -2)]) == "9 + k1 * -2"
