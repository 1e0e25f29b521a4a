"""What other packages add by their entry points: a command, a detector, formats of keypoints, rigs and trajectories."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import fgpose
from fgpose.cli import main
from fgpose.extensions import added
from fgpose.io.keypoints import keypoint_cameras
from fgpose.monocular.networks import open_network
from fgpose_benchmarks.synthetic import ring_rig

PACKAGE = '''
"""A package of somebody else."""
import json
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from tyro.conf import Positional
import fgpose
from fgpose.io.formats import KeypointFormat, RigFormat, TrajectoryFormat
from fgpose_benchmarks.synthetic import ring_rig


@dataclass(frozen=True, kw_only=True)
class Count:
    """Count the frames of a result."""

    result: Positional[Path]

    def run(self) -> None:
        print(f"{fgpose.load_trajectory(self.result).n_frames} frames")


@dataclass(frozen=True)
class Balls:
    max_people: int
    name: str = "balls"
    skeleton: fgpose.Skeleton = fgpose.load_skeleton("coco_17")

    def tracker(self, camera):
        raise NotImplementedError


def read(path, rig, skeleton):
    points2d_px = np.array(json.loads(path.read_text())["mine"])
    one = fgpose.Observations(
        skeleton=skeleton, camera_names=rig.names, time_s=np.arange(len(points2d_px)) / 30,
        points2d_px=points2d_px, confidence=np.ones(points2d_px.shape[:3]))
    return fgpose.people.PeopleObservations.of_one(one)


def is_mine(path):
    return path.is_file() and path.read_bytes().startswith(b'{"mine"')


KEYPOINTS = KeypointFormat(is_mine, lambda path: ring_rig().names, read)
RIG = RigFormat(lambda path: path.suffix == ".ring", lambda path: ring_rig(int(path.read_text())))


def write_trajectory(trajectory, path):
    path.write_text(json.dumps({"at": trajectory.time_s.tolist(), "points": trajectory.positions_m.tolist()}))


def read_trajectory(path):
    table = json.loads(path.read_text())
    points = np.array(table["points"])
    skeleton = fgpose.Skeleton("mine", tuple(f"joint{n}" for n in range(points.shape[1])), (), (0,), ())
    status = np.full(points.shape[:2], fgpose.Status.OBSERVED)
    return fgpose.Trajectory(skeleton=skeleton, time_s=np.array(table["at"]), positions_m=points, status=status)


TRAJECTORY = TrajectoryFormat(".mine", write_trajectory, read_trajectory)
'''
ENTRY_POINTS = """
[fgpose.commands]
count = my_package:Count
smooth = my_package:Count
gone = my_package:Gone
[fgpose.detectors]
balls = my_package:Balls
[fgpose.formats]
keypoints = my_package:KEYPOINTS
rig = my_package:RIG
trajectory = my_package:TRAJECTORY
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Installed, as pip would leave it."""
    (tmp_path / "my_package.py").write_text(PACKAGE)
    about = tmp_path / "my_package-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: my-package\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(ENTRY_POINTS)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    added.cache_clear()
    yield
    added.cache_clear()


def a_trajectory() -> fgpose.Trajectory:
    skeleton = fgpose.load_skeleton("coco_17")
    positions_m = np.random.default_rng(0).normal(size=(4, skeleton.n_joints, 3))
    status = np.full(positions_m.shape[:2], fgpose.Status.OBSERVED)
    return fgpose.Trajectory(skeleton=skeleton, time_s=np.arange(4) / 30, positions_m=positions_m, status=status)


@pytest.mark.filterwarnings("default:gone of my-package")
@pytest.mark.usefixtures("package")
def test_a_command_runs_and_replaces_none_of_ours(capsys: pytest.CaptureFixture[str]) -> None:
    fgpose.save_trajectory(a_trajectory(), "pose.npz")
    assert main(["count", "pose.npz"]) == 0
    printed = capsys.readouterr()
    assert printed.out == "4 frames\n"
    assert "warning: gone of my-package cannot be loaded" in printed.err
    with pytest.raises(SystemExit):
        main(["smooth", "--help"])
    assert "Count the frames" not in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "Count the frames" in capsys.readouterr().out


@pytest.mark.usefixtures("package")
def test_a_detector_is_a_model(capsys: pytest.CaptureFixture[str]) -> None:
    assert open_network("balls", max_people=3).name == "balls"
    with pytest.raises(ValueError, match="balls of another package says itself where it runs"):
        open_network("balls", device="cpu")
    for arguments in (["models"], ["models", "list"]):
        assert main(arguments) == 0
        assert "balls" in capsys.readouterr().out


@pytest.mark.usefixtures("package")
def test_formats_are_read_and_written(tmp_path: Path) -> None:
    points2d_px = np.random.default_rng(1).uniform(0, 900, (5, 4, 17, 2))
    keypoints, rig_file = tmp_path / "keypoints.json", tmp_path / "Calib.ring"
    keypoints.write_text(json.dumps({"mine": points2d_px.tolist()}))
    rig_file.write_text("4")
    rig = fgpose.load_rig(rig_file)
    assert rig.names == ring_rig(4).names == keypoint_cameras(keypoints)
    assert_allclose(fgpose.load_observations(keypoints, rig, "coco_17").points2d_px, points2d_px)
    assert fgpose.load_people(keypoints, rig, "coco_17").n_most == 1
    truth = a_trajectory()
    fgpose.save_trajectory(truth, "pose.mine")
    assert_allclose(fgpose.load_trajectory("pose.mine").positions_m, truth.positions_m)
    with pytest.raises(ValueError, match=r"written as .parquet, .npz, .csv, .trc, .c3d, .mine, not as .yours"):
        fgpose.save_trajectory(truth, "pose.yours")
