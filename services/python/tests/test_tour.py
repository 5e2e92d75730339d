"""The notebook is executed from its first to its last cell."""

from pathlib import Path

import pytest

nbclient = pytest.importorskip("nbclient")
nbformat = pytest.importorskip("nbformat")

TOUR = Path(__file__).parents[3] / "scripts" / "tour.ipynb"


def test_the_tour_runs_and_shows_what_it_says(repose_program):
    tour = nbformat.read(TOUR, as_version=4)
    assert not any(cell.get("outputs") for cell in tour.cells), "the notebook is kept without outputs"
    nbclient.NotebookClient(tour, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(TOUR.parent)}}).execute()
    outputs = [output for cell in tour.cells for output in cell.get("outputs", [])]
    said = "".join(output.text for output in outputs if output.output_type == "stream" and output.name == "stdout")
    assert "object 1:" in said
    assert "found" in said
    assert "none {" in said, "what rejected the candidates"
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) == 4
    table = said[said.index("F1 learned") :].splitlines()
    assert len(table) == 11
    left_of = table[1].split()
    assert left_of[0] == "left_of"
    assert float(left_of[2]) > 0.7, "from one view, most are read right"
