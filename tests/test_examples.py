"""Every example runs as a user would run it, and prints numbers that mean what it says."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
NUMBER = r"(-?\d+(?:\.\d+)?(?:e-?\d+)?)"


def run(name: str, *arguments: str, ignore: str = "") -> str:
    """What an example prints. It must not warn, but for a kind of warning that is to be expected."""
    options = ["-W", "error", *(["-W", f"ignore::{ignore}"] if ignore else [])]
    process = subprocess.run(
        [sys.executable, *options, str(EXAMPLES / name), *arguments], capture_output=True, text=True, timeout=120
    )
    assert process.returncode == 0, process.stderr
    assert process.stderr == ""
    return process.stdout


def numbers(pattern: str, text: str) -> list[float]:
    """The numbers in the first line that matches; each # of the pattern stands for one."""
    match = re.search(pattern.replace("#", NUMBER), text)
    assert match, f"{pattern!r} is not in:\n{text}"
    return [float(group) for group in match.groups()]


def test_one_joint():
    printed = run("01_one_joint.py")
    (squared_mm,) = numbers(r"least squares .* error # mm", printed)
    *sigmas_mm, error_mm = numbers(r"robust .* sigma \[ *# +# +#\] mm, error # mm", printed)
    # an outlier of 72 px is 28 cm at 4.5 m, a quarter or more of it in a mean of four
    assert squared_mm > 50
    # three axes of four sigma
    assert error_mm < 4 * sum(sigma_mm**2 for sigma_mm in sigmas_mm) ** 0.5
    # 3 px at 4.5 m and 1145 px are 12 mm for one view
    assert all(4 < sigma_mm < 15 for sigma_mm in sigmas_mm)


@pytest.mark.slow
def test_smooth_a_recording(tmp_path: Path):
    output = tmp_path / "balance.parquet"
    printed = run("02_smooth_a_recording.py", "--frames", "40", "--output", str(output))
    assert numbers(r"^# frames, # cameras", printed) == [40, 4]
    alone = numbers(r"each frame alone +jitter +# m/s\^3, bone spread +# mm, reprojection error +# px", printed)
    together = numbers(r"one motion +jitter +# m/s\^3, bone spread +# mm, reprojection error +# px", printed)
    # a person's own jerk is of the order of 100 m/s^3; detections of 10 px at 60 fps make thousands
    assert together[0] < alone[0] / 10
    assert together[1] < alone[1] / 3
    # smoother, and still where the detections are
    assert together[2] < 1.2 * alone[2]
    assert numbers(r"wrote .*: # frames of # joints", printed) == [40, 25]
    assert output.stat().st_size > 10_000


@pytest.mark.slow
def test_online():
    printed = run("03_online.py", "--frames", "40", "--lag-s", "0.25")
    updates, lagged = numbers(r"updates: #, lagged results: #", printed)
    assert updates == 40
    # 0.25 s are 15 frames of 60 a second
    assert lagged == 25
    (newest_mm,) = numbers(r"newest +differs from the batch result by # mm", printed)
    (later_mm,) = numbers(r"0.25 s later +differs from the batch result by # mm", printed)
    # the camera's own noise is 10 px, 4 cm at 4 m and 1100 px
    assert newest_mm < 30
    assert later_mm < 30


@pytest.mark.slow
def test_calibrate_from_people(tmp_path: Path):
    printed = run("13_calibrate_from_people.py", "--output", str(tmp_path))
    assert re.search(r"verdict: (good|coarse|failed); scale from ", printed)
    pairs = re.findall(rf"cam_0\d cam_0\d +{NUMBER}, true +{NUMBER} +{NUMBER}, true +{NUMBER}", printed)
    assert len(pairs) == 6
    # As measured with bundle adjustment of this recording: 2.2 degrees; the network's bones are 7 % too short.
    for distance, true_distance, angle, true_angle in np.array(pairs, dtype=float).tolist():
        assert distance == pytest.approx(true_distance, rel=0.15)
        assert angle == pytest.approx(true_angle, abs=6)
    assert (tmp_path / "rig.rrd").exists()


def test_custom_factor():
    printed = run("04_custom_factor.py")
    (jacobian_error,) = numbers(r"central differences #", printed)
    # rounding of 1 m / 1e-6 m
    assert jacobian_error < 1e-8
    measured = numbers(r"measured +left # mm, right # mm, difference # mm, right hand # mm", printed)
    estimated = numbers(r"estimated +left # mm, right # mm, difference # mm, right hand # mm", printed)
    assert abs(measured[2]) > 50
    assert abs(measured[3]) == 50
    # sigmas of 5 mm and 2 mm against positions of 30 mm
    assert abs(estimated[2]) < 5
    assert abs(estimated[3]) < 2
    assert measured[0] < estimated[0] < measured[1]


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["cam_01", "cam_04"])
def test_uncertainty(camera: str):
    printed = run("05_uncertainty.py", "--frames", "45", "--hide", camera)
    sigmas_mm = {
        joint: numbers(rf"{joint} +# +# +#", printed)
        for joint in ("neck", "left_elbow", "left_wrist", "right_wrist", "left_ankle")
    }
    for everything, without_one, _ in sigmas_mm.values():
        # three cameras for four, of which one may see the joint badly; 6 px at 4 m and 1100 px are 2 cm for one view;
        # the constant part of the errors, half of the variance, is estimated from what the views contradict each other
        # by all the time: with three of them for a third of it 0.35 of a detection's variance, not 0.96; eight samples
        # of errors, averaged over a second, tell a sigma to a tenth
        assert 0.6 * everything < without_one < 2.5 * everything
        assert 1 < everything < 20
    # of a second and a half in which nobody sees them; that shoulders and bones still tell of an elbow differs by clip
    for joint in ("left_elbow", "left_wrist"):
        assert sigmas_mm[joint][2] > 2 * sigmas_mm[joint][0]
    assert sigmas_mm["left_wrist"][2] > sigmas_mm["left_elbow"][2]
    # what is seen notices by a quarter: the components of its errors are estimated from what is left in 45 frames
    assert sigmas_mm["right_wrist"][2] == pytest.approx(sigmas_mm["right_wrist"][0], rel=0.25)
    # 2 of 25 joints
    assert numbers(r"arm hidden: # %", printed)[0] == pytest.approx(8, abs=1)


@pytest.mark.network
@pytest.mark.slow
def test_video_to_trajectory(tmp_path: Path, demo_videos: Path):
    output = tmp_path / "video.parquet"
    arguments = ("--frames", "12", "--output", str(output), "--model", "blazepose-lite")
    printed = run("06_video_to_trajectory.py", *arguments, ignore="UserWarning")
    assert numbers(r"^# images", printed) == [48]
    alone = numbers(r"each frame alone +jitter +# m/s\^3, reprojection error +# px", printed)
    together = numbers(r"one motion +jitter +# m/s\^3, reprojection error +# px", printed)
    assert together[0] < alone[0] / 10
    assert together[1] < 1.2 * alone[1]
    assert numbers(r"wrote .*: # frames of # joints", printed) == [12, 33]
    assert output.stat().st_size > 10_000


@pytest.mark.slow
def test_your_own_network():
    printed = run("07_your_own_network.py")
    assert numbers(r"^# images", printed) == [80]
    mean_mm, largest_mm = numbers(r"mean error # mm, largest # mm", printed)
    # balls are found to half a pixel, 2 mm at 4.5 m and 1145 px; a wave of 1 Hz is smoothed a little at its ends
    assert mean_mm < 4
    assert largest_mm < 20


@pytest.mark.slow
def test_unsynchronised_cameras(tmp_path: Path):
    output = tmp_path / "synchronised.toml"
    printed = run("08_unsynchronised_cameras.py", "--seconds", "2", "--output", str(output))
    for camera in ("ring_1", "ring_2", "ring_3"):
        true_ms, estimated_ms, sigma_ms = numbers(rf"{camera}: true +# ms, estimated +# \+/- # ms", printed)
        assert abs(true_ms) >= 25
        assert abs(estimated_ms - true_ms) < 3 * sigma_ms
    (before_mm,) = numbers(r"as if they were synchronous: # mm", printed)
    (after_mm,) = numbers(r"with estimated time offsets: # mm", printed)
    # a foot that swings at 4 m/s is 24 cm further after 60 ms
    assert after_mm < before_mm / 2
    assert output.read_text().count("time_offset_s") == 3


@pytest.mark.slow
def test_hallucinated_detections(tmp_path: Path):
    output = tmp_path / "visibility.png"
    printed = run("09_hallucinated_detections.py", "--clip", "cmu_02_01_short", "--output", str(output))
    visible, hallucinated = numbers(r"visible joints #, hallucinated ones #", printed)
    # hallucinations are ten times as far off as detections of visible joints; one in a hundred of these is an outlier
    assert visible > 0.9
    assert hallucinated < 0.2
    markov_mm, _ = numbers(r"markov: .* all joints # mm, left elbow # mm", printed)
    none_mm, _ = numbers(r"none: .* all joints # mm, left elbow # mm", printed)
    assert markov_mm < none_mm
    assert output.stat().st_size > 10_000


@pytest.mark.slow
def test_several_people(tmp_path: Path):
    output = tmp_path / "people.png"
    printed = run("10_several_people.py", "--people", "2", "--duration-s", "5", "--output", str(output))
    recall, precision = numbers(r"recall #%, precision #%", printed)
    # Who enters or leaves may be missed for some frames.
    assert min(recall, precision) > 97
    switches, error_mm = numbers(r"# identity switches, mean error # mm", printed)
    assert switches == 0
    # As noisy as the detections of one person, whose error is 15 to 25 mm.
    assert error_mm < 40
    assert output.stat().st_size > 10_000


@pytest.mark.slow
def test_several_people_live(tmp_path: Path):
    output = tmp_path / "live.rrd"
    arguments = ("--people", "2", "--cameras", "3", "--duration-s", "1.2", "--output", str(output))
    printed = run("11_several_people_live.py", *arguments)
    for person in (0, 1):
        # As soon as two cameras have seen them for 0.3 s.
        (confirmed_s,) = numbers(rf"# s +person {person} confirmed: ring_0", printed)
        assert confirmed_s < 0.3
    # After one second both are there.
    assert numbers(r"# s  here: 0 at .* m, 1 at .* m", printed) == [1.0]
    assert output.stat().st_size > 10_000


@pytest.mark.slow
def test_live_without_cameras(tmp_path: Path):
    output = tmp_path / "live.rrd"
    printed = run("12_live_without_cameras.py", "--duration-s", "5", "--rrd", str(output))
    first, *_, last = (line for line in printed.splitlines() if "observed" in line)
    assert all(f"  {person} c" in printed for person in (0, 1))
    assert "ring_3" not in first
    assert "ring_3 lost" in last
    # Frames come also without images.
    assert numbers(r"# frames, # ms after the images", printed)[0] > 10
    # As noisy as detections of one person, whose error is 15 to 25 mm; late where the computer is slow.
    assert numbers("mean error # mm", printed)[0] < 60
    assert output.stat().st_size > 10_000


@pytest.mark.slow
def test_study(tmp_path: Path):
    # Dask's own, when its processes end.
    arguments = ("--output", str(tmp_path / "study"), "--seconds", "0.2", "--sessions", "evening")
    printed = run("14_study.py", *arguments, ignore="ResourceWarning")
    assert "5 done, 1 failed" in printed
    assert "1 failed, 5 unchanged" in printed
    assert printed.count("failed: S03/evening/sword: ") == 2
    for subject in ("S01", "S02", "S03"):
        # Of somebody who stands with bent knees.
        assert 0 < numbers(rf"{subject}: largest flexion of the left knee # degrees", printed)[0] < 120
