"""`creak paper`, as a user runs it: the paper's own findings, and the files that show them."""

import json
import re
import resource
import struct
import subprocess
import sys
import time

import numpy as np
import pytest

from creak.cli import run
from creak.mechanics.newmark import Stepper
from creak.mechanics.system import assemble
from creak.paper import studies
from creak.sources.simulated import SimulatedRig

FIGURES = [f"figure-{number:02d}.png" for number in (6, 7, 8, 9, 12, 13, 14, 15, 16)]


@pytest.fixture(scope="module")
def paper(tmp_path_factory):
    """Document, directory and seconds of computing of one run."""
    directory = tmp_path_factory.mktemp("paper") / "made" / "here"
    begun = computed()
    done = subprocess.run(
        [sys.executable, "-m", "creak.cli", "paper", "--json", "--output", str(directory)],
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout), directory, computed() - begun, done.stderr


def computed():
    """Seconds of computing of finished child processes: what else the machine does does not count."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def column(nodes, key):
    return np.array([node[key] for node in nodes], dtype=float)


def test_three_masses_are_as_in_the_paper(paper):
    """Figures 7 and 9; kills a wrong model, a network with n in place of the imposed edges, sub-stepping (levels
    of the method: classical 26.8, 26.7, 28.4 dB; networked 0.0, -0.2, 16.0 dB)."""
    runs = paper[0]["three-mass"]
    assert list(runs) == ["linear", "cubic"]
    np.testing.assert_allclose(column(runs["linear"], "total_to_noise_db"), 0, atol=0.5)
    np.testing.assert_allclose(column(runs["linear"], "classical_total_to_noise_db"), 0, atol=0.5)
    np.testing.assert_allclose(column(runs["cubic"], "total_to_noise_db"), [0.0, -0.2, 16.0], atol=0.5)
    np.testing.assert_allclose(column(runs["cubic"], "classical_total_to_noise_db"), [26.8, 26.7, 28.4], atol=1)
    assert [node["alarm"] for node in runs["linear"]] == ["normal"] * 3
    assert [node["alarm"] == "normal" for node in runs["cubic"]] == [True, True, False]


def test_the_beam_is_as_in_the_paper(paper):
    """Figures 13 to 16; kills a calibration that has drifted, and a location that strong distortion spoils."""
    runs = paper[0]["beam"]
    assert list(runs) == ["k=0", "k=1", "k=10"]
    assert [node["alarm"] for node in runs["k=0"]] == ["normal"] * 3
    for k in ("k=1", "k=10"):
        assert [node["alarm"] == "normal" for node in runs[k]] == [True, True, False]
        assert column(runs[k], "classical_total_to_noise_db").min() > 10
    clear = [runs[k][2]["nonlinear_db"] - runs[k][2]["noise_db"] for k in ("k=1", "k=10")]
    assert clear[0] == pytest.approx(10, abs=1.5)
    assert clear[1] > clear[0] + 5


def test_one_command_writes_page_and_figures_within_a_minute(paper):
    _, directory, seconds, stderr = paper
    assert seconds < 60
    assert stderr == ""  # no progress where nobody watches
    assert sorted(path.name for path in directory.iterdir()) == [*FIGURES, "index.html"]
    for name in FIGURES:
        head = (directory / name).read_bytes()[:24]
        assert head.startswith(b"\x89PNG")
        width, height = struct.unpack(">II", head[16:])
        assert width > 900
        assert height > 300


def test_the_page_shows_every_figure_every_node_and_the_calibration(paper):
    """Kills a page whose pictures are elsewhere, and numbers that are not those of the document."""
    document, directory, *_ = paper
    page = (directory / "index.html").read_text(encoding="utf-8")
    assert re.findall(r'src="([^"]+)"', page) == FIGURES
    assert f"{studies.SPRING_UNIT:.3g} N/m³" in page
    for runs in document.values():
        for nodes in runs.values():
            for node in nodes:
                assert f"<td>{node['total_to_noise_db']:.1f}</td>" in page
    assert "http" not in page  # it is to be read offline


def test_one_step_a_sample_is_one_step_a_sample():
    """Kills `substeps` that is accepted and ignored: the paper's own integration has its own error."""
    rig, model = studies.three_masses(1e8)
    source = SimulatedRig(rig, model, steady_periods=1, rms=50.0, seed=1, realisations=1, substeps=1)
    frames = list(source.frames())
    stepper = Stepper(assemble(model, rig), rig.sample_rate, 1, rig.hold)
    expected = list(stepper.experiment(frames[0].u, 3))
    for frame, y in zip(frames[:3], expected, strict=True):
        np.testing.assert_array_equal(frame.y, y)


def test_an_output_that_is_a_file_is_refused_before_anything_is_computed(tmp_path, capsys):
    taken = tmp_path / "taken"
    taken.write_text("mine")
    begun = time.monotonic()
    assert run(["paper", "--output", str(taken)]) == 2
    assert run(["paper", "--output", str(taken / "below")]) == 2
    assert time.monotonic() - begun < 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert all("--output" in line and str(taken) in line for line in lines)
    assert taken.read_text() == "mine"
