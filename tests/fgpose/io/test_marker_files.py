from __future__ import annotations

import dataclasses
import warnings
from pathlib import Path

import numpy as np
import pytest

from fgpose.assessment.evaluation import evaluate
from fgpose.io.skeletons import builtin_skeletons, load_skeleton
from fgpose.io.trajectories import load_trajectory, save_trajectory
from fgpose.kinematics.angles import joint_angles
from fgpose.shown.joint_meanings import joint_of_marker, marker_of_joint
from fgpose.trajectory import Status, Trajectory

DATA = Path(__file__).parents[2] / "data" / "trc"
REAL_TRC = DATA / "S00_P00_T01_BalancingTrial_0-20.trc"
LSTM_TRC = DATA / "S00_P00_T01_BalancingTrial_0-2_LSTM.trc"


@pytest.fixture
def trajectory() -> Trajectory:
    """Five frames at 50 Hz, two joints unknown in one frame each."""
    skeleton = load_skeleton("halpe_26")
    positions_m = np.random.default_rng(0).normal(size=(5, skeleton.n_joints, 3))
    status = np.full((5, skeleton.n_joints), Status.OBSERVED)
    for gap in ((1, 4), (3, -1)):
        positions_m[gap], status[gap] = np.nan, Status.UNOBSERVABLE
    return Trajectory(skeleton, 2.0 + np.arange(5) / 50, positions_m, status)


def test_real_trc_reads_as_the_numbers_in_the_file():
    loaded = load_trajectory(REAL_TRC)
    rows = [line.split("\t") for line in REAL_TRC.read_text().splitlines()[5:]]
    table = np.array(rows, dtype=float)
    assert loaded.skeleton.joints[:7] == (
        *("right_hip", "right_knee", "right_ankle", "right_big_toe", "right_small_toe", "right_heel"),
        "left_hip",
    )
    assert loaded.skeleton.root == (6, 0)
    assert loaded.n_frames == 20
    np.testing.assert_array_equal(loaded.time_s, table[:, 1])
    # OpenSim (x, y up, z) = world (Y, Z up, X)
    np.testing.assert_array_equal(loaded.positions_m[..., 1], table[:, 2::3])
    np.testing.assert_array_equal(loaded.positions_m[..., 2], table[:, 3::3])
    np.testing.assert_array_equal(loaded.positions_m[..., 0], table[:, 4::3])
    assert loaded.observed.all()
    np.testing.assert_array_equal(load_trajectory(REAL_TRC, world_up="y").positions_m[..., 1], table[:, 3::3])


def test_real_trc_stands_upright_in_the_world():
    loaded = load_trajectory(REAL_TRC)
    head, heel = (loaded.positions_m[:, loaded.skeleton.index(joint), 2] for joint in ("head", "left_heel"))
    assert np.all(head - heel > 1.0)


def test_real_trc_with_odd_header_and_empty_line_is_read():
    loaded = load_trajectory(LSTM_TRC)
    assert loaded.positions_m.shape == (2, 64, 3)
    assert loaded.skeleton.joints[0] == "right_hip"
    assert "r.ASIS_study" in loaded.skeleton.joints
    np.testing.assert_array_equal(loaded.positions_m[0, 0], [-1.4005736, -0.0649978, 0.8690172])


def parse_trc(path: Path) -> tuple[list[str], list[str], list[list[str]]]:
    """Header values, marker names and cells, by nothing but the layout of the format."""
    lines = path.read_text().split("\n")
    assert lines[-1] == ""
    names = lines[3].split("\t")
    return lines[2].split("\t"), names[2::3], [line.split("\t") for line in lines[5:-1]]


@pytest.mark.parametrize("world_up", ["z", "y"])
def test_trc_written_reads_back_here_and_elsewhere(trajectory, tmp_path, world_up):
    path = tmp_path / "result.trc"
    save_trajectory(trajectory, path, world_up)
    loaded = load_trajectory(path, trajectory.skeleton, world_up)
    np.testing.assert_array_equal(loaded.time_s, trajectory.time_s)
    np.testing.assert_array_equal(loaded.positions_m, trajectory.positions_m)
    assert (loaded.status[1, 4], loaded.status[0, 0]) == (Status.UNOBSERVABLE, Status.OBSERVED)

    header, markers, rows = parse_trc(path)
    assert header == ["50", "50", "5", "26", "m", "50", "1", "5"]
    assert markers[11:14] == ["LHip", "RHip", "LKnee"]
    assert [row[0] for row in rows] == ["1", "2", "3", "4", "5"]
    assert {len(row) for row in rows} == {2 + 3 * 26}
    assert rows[1][2 + 3 * 4 : 5 + 3 * 4] == rows[3][-3:] == ["nan", "nan", "nan"]
    order = [1, 2, 0] if world_up == "z" else [0, 1, 2]
    np.testing.assert_array_equal(np.array(rows[0][2:], dtype=float), trajectory.positions_m[0][:, order].ravel())


def test_a_joint_with_one_unknown_coordinate_is_a_gap(trajectory, tmp_path):
    positions_m = trajectory.positions_m.copy()
    positions_m[0, 0, 1] = np.nan
    partial = dataclasses.replace(trajectory, positions_m=positions_m)
    save_trajectory(partial, tmp_path / "result.trc")
    assert parse_trc(tmp_path / "result.trc")[2][0][2:5] == ["nan", "nan", "nan"]


LENIENT = """PathFileType  4\t(X/Y/Z) a  b.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
100\t100\t99\t2\tmm\t100\t0\t99
Frame#\tTime\tRHip \t\t\tSACR\t\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2

0\t0.0\t 1000\t2000 \t3000\t\t\t\t
1\t0.01\tnan\tnan\tnan\t1\t2\t3

2\t0.02\t4\t5\t6
"""


def test_what_writers_do_differently_is_read(tmp_path):
    path = tmp_path / "other.trc"
    path.write_text(LENIENT)
    loaded = load_trajectory(path)
    assert loaded.skeleton.joints == ("right_hip", "SACR")
    np.testing.assert_array_equal(loaded.time_s, [0.0, 0.01, 0.02])
    nan = [np.nan] * 3
    expected = [[[3.0, 1.0, 2.0], nan], [nan, [0.003, 0.001, 0.002]], [[0.006, 0.004, 0.005], nan]]
    np.testing.assert_array_equal(loaded.positions_m, expected)
    np.testing.assert_array_equal(loaded.observed, [[True, False], [False, True], [True, False]])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\tmm\t", "\tinch\t", "line 3: Units must be m, cm or mm, got inch"),
        ("\t4\t5\t6", "\t4\t5,1\t6", "line 10, RHip: '5,1' is not a number"),
        ("\t4\t5\t6", "\t4\t5\t6\t7\t8\t9\t10", "line 10: there are more cells than 2 markers need"),
        ("2\t0.02", "2\t", "line 10: there is no time"),
        ("SACR", "RHip", "repeated: RHip"),
        ("RHip \t\t\tSACR", "", "line 4 names no marker"),
        (LENIENT.split("\n", 2)[2], "", "it lacks the five header lines"),
    ],
)
def test_a_bad_trc_is_refused_by_name_and_place(tmp_path, old, new, message):
    path = tmp_path / "bad.trc"
    assert old in LENIENT
    path.write_text(LENIENT.replace(old, new))
    with pytest.raises(ValueError, match=r"bad\.trc.*" + message):
        load_trajectory(path)


def test_markers_of_one_joint_keep_their_own_names(tmp_path):
    path = tmp_path / "two.trc"
    path.write_text(LENIENT.replace("SACR", "RightHip"))
    assert load_trajectory(path).skeleton.joints == ("RHip", "RightHip")


@pytest.mark.parametrize("name", builtin_skeletons())
def test_marker_names_read_back_as_the_joints_they_were(name):
    for joint in load_skeleton(name).joints:
        assert joint_of_marker(marker_of_joint(joint)) == joint


@pytest.mark.parametrize(
    ("marker", "joint"),
    [("LBigToe", "left_big_toe"), ("MidHip", "pelvis"), ("Neck", "neck"), ("LASI", "LASI"), ("C7_study", "C7_study")],
)
def test_marker_names_of_pose2sim_are_joints(marker, joint):
    assert joint_of_marker(marker) == joint


def test_c3d_written_reads_back_with_gaps_marked(trajectory, tmp_path):
    ezc3d = pytest.importorskip("ezc3d")
    path = tmp_path / "result.c3d"
    save_trajectory(trajectory, path)
    file = ezc3d.c3d(str(path))
    parameters = {name: list(entry["value"]) for name, entry in file["parameters"]["POINT"].items() if "value" in entry}
    assert parameters["UNITS"] == ["mm"]
    assert parameters["RATE"] == [50.0]
    assert parameters["LABELS"][11:13] == ["LHip", "RHip"]
    assert (parameters["X_SCREEN"], parameters["Y_SCREEN"]) == (["+X"], ["+Z"])
    gaps = np.isnan(trajectory.positions_m[..., 0]).T
    np.testing.assert_array_equal(file["data"]["meta_points"]["residuals"][0], np.where(gaps, -1.0, 0.0))
    np.testing.assert_array_equal(np.isnan(file["data"]["points"][:3]), np.broadcast_to(gaps, (3, *gaps.shape)))
    expected_mm = 1000 * trajectory.positions_m.transpose(2, 1, 0)
    # C3D holds 32 bit numbers, 24 of them significant.
    np.testing.assert_allclose(file["data"]["points"][:3], expected_mm, rtol=2**-24)


@pytest.mark.parametrize("world_up", ["z", "y"])
def test_c3d_reads_back_as_a_trajectory(trajectory, tmp_path, world_up):
    pytest.importorskip("ezc3d")
    path = tmp_path / "result.c3d"
    save_trajectory(trajectory, path, world_up)
    loaded = load_trajectory(path, trajectory.skeleton, world_up)
    # 32 bit numbers
    np.testing.assert_allclose(loaded.positions_m, trajectory.positions_m, rtol=2**-23)
    np.testing.assert_allclose(loaded.time_s, trajectory.time_s, rtol=2**-23)
    np.testing.assert_array_equal(loaded.status == Status.UNOBSERVABLE, trajectory.status == Status.UNOBSERVABLE)


def test_c3d_up_axis_is_turned_to_that_of_the_world(trajectory, tmp_path):
    pytest.importorskip("ezc3d")
    save_trajectory(trajectory, tmp_path / "result.c3d", world_up="z")
    loaded = load_trajectory(tmp_path / "result.c3d", trajectory.skeleton, world_up="y")
    np.testing.assert_allclose(loaded.positions_m[..., 1], trajectory.positions_m[..., 2], rtol=2**-23)


def test_c3d_warns_of_times_it_cannot_hold(trajectory, tmp_path):
    pytest.importorskip("ezc3d")
    uneven = dataclasses.replace(trajectory, time_s=np.array([0.0, 0.02, 0.04, 0.075, 0.095]))
    with pytest.warns(UserWarning, match=r"constant frame rate, 50 Hz.*frame 4 is 5 ms earlier"):
        save_trajectory(uneven, tmp_path / "uneven.c3d")
    epoch = dataclasses.replace(trajectory, time_s=1.7e9 + np.arange(5) / 50)
    with pytest.warns(UserWarning, match=r"cannot hold a start at 1\.7e\+09 s"):
        save_trajectory(epoch, tmp_path / "epoch.c3d")
    # A fifth of an interval is let pass: cameras jitter.
    jittery = dataclasses.replace(trajectory, time_s=np.array([0.0, 0.02, 0.0401, 0.06, 0.08]))
    save_trajectory(jittery, tmp_path / "jittery.c3d")


@pytest.mark.parametrize(("rate_hz", "rounded_s"), [(60.0, 1e-3), (60.0, 1e-4), (30.0, 1e-3), (60 / 1.001, 1e-4)])
def test_times_that_were_rounded_keep_their_rate(tmp_path, rate_hz: float, rounded_s: float) -> None:
    """A minute of it; 60 Hz to 1 ms was 58.8 Hz, and its end 1.2 s early."""
    pytest.importorskip("ezc3d")
    time_s = np.round(np.arange(round(60 * rate_hz)) / rate_hz / rounded_s) * rounded_s
    skeleton = dataclasses.replace(load_trajectory(REAL_TRC).skeleton, joints=("nose",), root=(0,))
    status = np.full((len(time_s), 1), Status.OBSERVED)
    rounded = Trajectory(skeleton, time_s, np.ones((len(time_s), 1, 3)), status)
    save_trajectory(rounded, tmp_path / "walk.c3d")
    # Of the first and the last time each is off by half of what they are rounded to, and the rate is a 32 bit number.
    assert load_trajectory(tmp_path / "walk.c3d").time_s[-1] == pytest.approx(time_s[-1], abs=rounded_s)
    save_trajectory(rounded, tmp_path / "walk.trc")
    (data_rate, *_) = (tmp_path / "walk.trc").read_text().splitlines()[2].split("\t")
    assert float(data_rate) == pytest.approx(rate_hz, rel=rounded_s / 60)


@pytest.mark.parametrize(("later_s", "words"), [(0.009, "9 ms too early"), (-0.009, "9 ms too late"), (0.0005, "")])
def test_c3d_keeps_a_start_between_two_frames(trajectory, tmp_path, later_s: float, words: str) -> None:
    """Other programs know nothing of it: it is said where it is more than 1 ms."""
    pytest.importorskip("ezc3d")
    later = dataclasses.replace(trajectory, time_s=trajectory.time_s + later_s)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        save_trajectory(later, tmp_path / "later.c3d")
    assert [words in str(each.message) for each in said] == ([True] if words else [])
    np.testing.assert_allclose(load_trajectory(tmp_path / "later.c3d").time_s, later.time_s, rtol=2**-23)


def test_c3d_refuses_more_frames_than_its_header_counts(tmp_path):
    pytest.importorskip("ezc3d")
    skeleton = dataclasses.replace(load_trajectory(REAL_TRC).skeleton, joints=("nose",), root=(0,))
    n_frames = 65536
    status = np.full((n_frames, 1), Status.OBSERVED)
    long = Trajectory(skeleton, np.arange(n_frames) / 50, np.zeros((n_frames, 1, 3)), status)
    with pytest.raises(ValueError, match=r"long\.c3d: C3D holds at most 65535 frames"):
        save_trajectory(long, tmp_path / "long.c3d")


@pytest.mark.parametrize("extension", [".trc", ".c3d"])
def test_a_single_frame_can_be_written(trajectory, tmp_path, extension):
    if extension == ".c3d":
        pytest.importorskip("ezc3d")
    one = Trajectory(trajectory.skeleton, np.zeros(1), trajectory.positions_m[:1].copy(), trajectory.status[:1].copy())
    save_trajectory(one, tmp_path / f"one{extension}")
    loaded = load_trajectory(tmp_path / f"one{extension}", trajectory.skeleton)
    np.testing.assert_allclose(loaded.positions_m, one.positions_m, rtol=2**-23)


@pytest.mark.parametrize("extension", [".trc", ".c3d"])
def test_zeros_of_other_programs_are_gaps(trajectory, tmp_path, extension):
    if extension == ".c3d":
        pytest.importorskip("ezc3d")
    path = tmp_path / f"gaps{extension}"
    positions_m = trajectory.positions_m.copy()
    positions_m[2:4, 7] = positions_m[2, 1] = 0.0
    positions_m[0, 0, :2] = 0.0  # two coordinates may be zero
    save_trajectory(dataclasses.replace(trajectory, positions_m=positions_m), path)
    names = ", ".join(marker_of_joint(trajectory.skeleton.joints[joint]) for joint in (1, 7))
    said = rf"gaps\{extension}: 3 of 130 positions are exactly \(0, 0, 0\), of {names}: they are taken for missing"
    with pytest.warns(UserWarning, match=said):
        loaded = load_trajectory(path, trajectory.skeleton)
    expected_m = np.where((positions_m == 0).all(axis=-1, keepdims=True), np.nan, positions_m)
    np.testing.assert_allclose(loaded.positions_m, expected_m, rtol=2**-23)
    assert (loaded.status[2:4, 7] == Status.UNOBSERVABLE).all()


@pytest.mark.parametrize("extension", [".trc", ".c3d"])
def test_the_subject_before_all_markers_is_no_part_of_their_names(trajectory, tmp_path, extension):
    if extension == ".c3d":
        pytest.importorskip("ezc3d")
    names = tuple(marker_of_joint(joint) for joint in trajectory.skeleton.joints)

    def written(joints: tuple[str, ...]) -> Path:
        skeleton = dataclasses.replace(trajectory.skeleton, joints=joints)
        save_trajectory(dataclasses.replace(trajectory, skeleton=skeleton), tmp_path / f"walk{extension}")
        return tmp_path / f"walk{extension}"

    # Markers that are not labelled have none.
    path = written((names[0], *(f"Sub1:{name}" for name in names[1:])))
    assert load_trajectory(path).skeleton.joints == trajectory.skeleton.joints
    path = written((*(f"Sub1:{name}" for name in names[:-1]), f"Sub2:{names[0]}"))
    with pytest.warns(UserWarning, match=r"markers are of several subjects: Sub1 \(25\), Sub2 \(1\)\. .* alone"):
        assert "Sub1:Nose" in load_trajectory(path).skeleton.joints
    path = written((names[1], f"Sub1:{names[1]}", *names[2:]))
    assert f"Sub1:{names[1]}" in load_trajectory(path).skeleton.joints


def absent_in(trajectory: Trajectory, frames: list[int]) -> Trajectory:
    """The same with nobody in some frames."""
    positions_m, status = trajectory.positions_m.copy(), trajectory.status.copy()
    positions_m[frames], status[frames] = np.nan, Status.UNOBSERVABLE
    return dataclasses.replace(trajectory, positions_m=positions_m, status=status)


def test_trc_has_no_rows_of_nobody(trajectory, tmp_path):
    """OpenSim's inverse kinematics ends at one, and its scaling does nothing where there is one."""
    gone = absent_in(trajectory, [0, 2])
    save_trajectory(gone, tmp_path / "gone.trc", "z")
    header, _, rows = parse_trc(tmp_path / "gone.trc")
    assert header == ["50", "50", "3", "26", "m", "50", "1", "3"]
    assert [row[:2] for row in rows] == [["2", "2.02"], ["4", "2.06"], ["5", "2.08"]]
    loaded = load_trajectory(tmp_path / "gone.trc", gone.skeleton, file_up="y")
    expected = gone.frames(~gone.absent)
    np.testing.assert_array_equal(loaded.time_s, expected.time_s)
    np.testing.assert_array_equal(loaded.positions_m, expected.positions_m)
    np.testing.assert_array_equal(loaded.frame_numbers, [1, 3, 4])
    save_trajectory(loaded, tmp_path / "again.trc", "z")
    assert parse_trc(tmp_path / "again.trc")[1:] == parse_trc(tmp_path / "gone.trc")[1:]


def test_a_trc_with_gaps_is_measured_as_the_result(tmp_path):
    whole = load_trajectory(REAL_TRC)
    gone = absent_in(whole, [5, 6, 7])
    save_trajectory(gone, tmp_path / "gone.trc")
    loaded = load_trajectory(tmp_path / "gone.trc")
    (header, _, _) = parse_trc(tmp_path / "gone.trc")
    assert float(header[0]) == pytest.approx(60.0, rel=1e-3)  # without the gap; times are rounded
    shifted = dataclasses.replace(whole, positions_m=whole.positions_m + np.array([0.0, 0.0, 0.02]))
    of_file, of_result = evaluate(loaded, shifted), evaluate(gone, shifted)
    assert of_file.mpjpe_absolute_mm == pytest.approx(20.0)
    assert (of_file.n_frames, of_file.share_missing) == (17, 0.0)
    assert (of_result.n_frames, of_result.share_missing) == (20, 3 / 20)
    np.testing.assert_array_equal(joint_angles(loaded).angle_deg, joint_angles(gone).angle_deg[~gone.absent])


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [(("1", "2", "4"), [0, 1, 3]), (("0", "5", "6"), [0, 5, 6]), (("7", "8", "9"), [6, 7, 8])]
    + [
        (cells, None)
        for cells in (("1", "1", "2"), ("3", "2", "1"), ("a", "b", "c"), ("", "", ""), ("1", "2", "9" * 30))
    ],
)
def test_frame_numbers_of_a_trc_are_kept_where_they_increase(tmp_path, numbers, expected):
    text = LENIENT
    for old, new in zip(("\n0\t0.0\t", "\n1\t0.01\t", "\n2\t0.02\t"), numbers, strict=True):
        text = text.replace(old, f"\n{new}\t" + old.split("\t", 1)[1])
    (tmp_path / "other.trc").write_text(text)
    found = load_trajectory(tmp_path / "other.trc").frame_numbers
    assert (None if found is None else found.tolist()) == expected
