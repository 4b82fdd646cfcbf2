"""What speaks against windows, where it is a matter of counting."""

import pytest

from training.gap.load_checks import _with_the_lever


@pytest.mark.parametrize(
    ("hidden", "edges", "by_chance", "expected"),
    [
        (6, 6, 0.3, True),  # each change at a move of the lever, which moves a third of the time
        (5, 6, 0.3, True),
        (9, 16, 0.36, False),  # rather many, but seven that no lever made
        (2, 6, 0.3, False),
        (0, 6, 0.3, False),
        (6, 6, 0.9, False),  # a lever that hardly rests hides any change
        (0, 0, 0.3, False),
    ],
)
def test_changes_at_moves_of_the_lever_count_against_what_chance_makes(
    hidden, edges, by_chance, expected
):
    assert _with_the_lever(hidden, edges, by_chance) is expected
