"""A small pool through the command line: plain effects are named, nothing where nothing belongs."""

import json
from pathlib import Path

import pytest

from designlab.app import cli

pytestmark = [pytest.mark.recovery, pytest.mark.slow, pytest.mark.renders]


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> dict:
    """Rows of the score by set."""
    out = Path(tmp_path_factory.mktemp("benchmark")) / "out"
    assert cli.main(["gap", "benchmark", "--pool", "quick", "--out", str(out)]) == 0
    return json.loads((out / "score.json").read_text())


def test_where_nothing_is_hidden_nothing_is_named(found) -> None:
    assert found["nothing"]["sets"] == 1
    assert found["confusion"]["nothing"] == {"at_floor": 1}


def test_hidden_effects_are_named_first_and_their_gap_is_closed(found) -> None:
    single = found["single"]
    assert single["sets"] == 3
    assert single["right_first"]["share"] == single["truth_in_set"]["share"] == 1.0
    assert single["gap_removed_median"] > 0.9 > 0.2 > single["control_removed_median"]
    assert single["value_error_median"] < 0.1


def test_what_the_catalogue_lacks_is_not_explained_away(found) -> None:
    assert found["outside"]["abstained"]["share"] == 1.0
    assert found["left_out"]["abstained"]["share"] == 1.0
