from __future__ import annotations

import json
import warnings
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fgpose import pipeline
from fgpose.config import Config
from fgpose.diagnosis.diagnose import Diagnosis
from fgpose.estimation.evidence import fusion
from fgpose.estimation.evidence import gather as gather_module
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.evidence.image_checks.sides import limb_joints
from fgpose.estimation.online.window import Window
from fgpose.estimation.residuals import whitened_residuals
from fgpose.estimation.settling import informed
from fgpose.estimation.smoother import smooth
from fgpose.finding import Code, Finding, Severity
from fgpose.geometry.camera import Camera, CameraRig
from fgpose.geometry.reprojection import reprojection_residual_px
from fgpose.geometry.triangulation import Triangulation, triangulate_robust
from fgpose.geometry.up_axis import z_up_R_world
from fgpose.io.calibration import save_rig
from fgpose.io.calibration.calibration_origin import CalibrationOrigin
from fgpose.io.content import read_content
from fgpose.io.keypoints import detections, save_observations
from fgpose.io.origin import Origin
from fgpose.io.recordings import load_recording
from fgpose.io.trajectories import load_trajectory, save_people, save_trajectory
from fgpose.observations import Observations
from fgpose.pipeline import (
    Outputs,
    Result,
    Source,
    load_source,
    run_calibrate,
    run_refine,
    run_smooth,
    run_track,
    write_outputs,
)
from fgpose.pipeline.diagnosed import diagnosed
from fgpose.trajectory import Estimate, Status
from fgpose.viewer import Recording, open_recording

pytestmark = pytest.mark.usefixtures("without_search_for_faults")
SHORT_LAG = Config(online={"lag_s": 0.1})


@pytest.fixture(scope="module")
def source() -> Source[Observations]:
    rig, observations = load_recording("balance_openpose")
    return Source(rig, observations.frames(slice(0, 20)))


@pytest.fixture(scope="module")
def smoothed(source: Source[Observations]) -> Result:
    return run_smooth(source, Config())


@pytest.fixture(scope="module")
def tracked(source: Source[Observations]) -> Result:
    return run_track(source, SHORT_LAG)


@pytest.mark.slow
def test_smooth_gives_what_the_smoother_gives(source: Source[Observations], smoothed: Result) -> None:
    expected = smooth(source.observations, source.rig, Config())
    np.testing.assert_array_equal(smoothed.main[0].positions_m, expected.positions_m)
    assert list(smoothed.trajectories) == ["fused", "refined", "smoothed"]
    assert smoothed.saved == ("smoothed",)


def test_comparison_can_be_left_out(source: Source[Observations]) -> None:
    assert list(run_smooth(source, Config(), compare=False).trajectories) == ["smoothed"]


def test_progress_ends_with_all_frames(source: Source[Observations]) -> None:
    few = Source(source.rig, source.observations.frames(slice(0, 5)))
    for run in (run_smooth, run_refine, run_track):
        seen: list[tuple[int, int]] = []
        run(few, Config(), lambda done, total, seen=seen: seen.append((done, total)))
        assert seen[-1] == (5, 5)


def test_track_collects_newest_and_lagged_estimates(source: Source[Observations], tracked: Result) -> None:
    online, lagged = tracked.trajectories["online"][0], tracked.trajectories["smoothed"][0]
    assert online.n_frames == 20
    assert online.covariance_m2 is not None
    assert tracked.update_ms is not None
    assert tracked.update_ms.shape == (20,)
    # 0.1 s are 6 frames: frames 0 to 13 are that old in the end, one less where times round down.
    assert lagged.n_frames in (13, 14)
    np.testing.assert_array_equal(lagged.time_s, source.observations.frame_time_s[: lagged.n_frames])
    known = np.isfinite(lagged.positions_m).all(axis=-1)
    np.testing.assert_array_equal(known, lagged.status != Status.UNOBSERVABLE)


def test_lagged_estimates_are_smoother(tracked: Result) -> None:
    """What has seen the next 0.1 s moves less from frame to frame than what has not."""
    steps = {
        name: np.nanmedian(np.linalg.norm(np.diff(people[0].positions_m[:13], n=2, axis=0), axis=-1))
        for name, people in tracked.trajectories.items()
    }
    assert steps["smoothed"] < steps["online"]


def test_recording_shorter_than_the_lag_has_no_lagged_estimates(source: Source[Observations]) -> None:
    assert list(run_track(source, Config()).trajectories) == ["online"]


def test_each_update_is_shown(source: Source[Observations]) -> None:
    seen: list[int] = []

    class Viewer(Recording):
        def log_estimate(self, estimate: Estimate, observations: Any = None, weights: Any = None, **more: Any) -> None:
            assert observations.n_frames == 1
            assert weights.shape == observations.confidence.shape[1:]
            assert more["update_ms"] > 0
            seen.append(estimate.frame)

    run_track(Source(source.rig, source.observations.frames(slice(0, 5))), Config(), viewer=Viewer())
    assert seen == list(range(5))


def test_every_format_is_written_and_read_again(tmp_path: Path, smoothed: Result) -> None:
    outputs = Outputs(tmp_path / "new", "walk", ("parquet", "npz", "trc", "c3d", "rrd"))
    written = write_outputs(smoothed, outputs)
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == sorted(path.name for path in written)
    for path in written:
        if path.suffix != ".rrd":
            positions_m = load_trajectory(path, smoothed.main[0].skeleton).positions_m
            # C3D keeps 32 bit millimetres.
            np.testing.assert_allclose(positions_m, smoothed.main[0].positions_m, atol=1e-6)
    assert load_trajectory(tmp_path / "new" / "walk.parquet").config == Config()


@pytest.mark.parametrize("name", ["", ".", "..", ".walk", "../walk", "a/walk", "walk/"])
def test_a_name_that_hides_results_or_puts_them_elsewhere_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=f"{name!r} is no name of result files"):
        Outputs(tmp_path, name, ("npz",))


def test_several_trajectories_have_files_of_their_own(tmp_path: Path, tracked: Result) -> None:
    written = write_outputs(tracked, Outputs(tmp_path, "walk", ("npz",)))
    assert {path.name for path in written} == {"walk_online.npz", "walk_smoothed.npz"}


def test_people_that_an_earlier_run_found_do_not_stay_beside_a_result(tmp_path: Path, smoothed: Result) -> None:
    (walker,) = smoothed.main.values()
    earlier, of_others, origin = tmp_path / "walk.trc", tmp_path / "walk_person7.trc", Origin(step="smooth")
    save_people({0: walker, 1: walker}, earlier, origin=origin)
    of_others.write_text("somebody's own")
    # Results of other names, although they look alike.
    named = {tmp_path / f"walk_person{name}" for name in ("_adaptive.trc", "2.trc", "2.parquet", "3.parquet")}
    for path in named:
        save_trajectory(walker, path, origin=origin)
    outputs = Outputs(tmp_path, "walk", ("trc", "parquet"), step="smooth")
    assert write_outputs(smoothed, outputs) == (earlier, tmp_path / "walk.parquet")
    assert set(tmp_path.iterdir()) == {earlier, tmp_path / "walk.parquet", of_others, *named}


def test_a_run_that_is_killed_while_it_writes_leaves_no_file_of_the_viewer_from_before(
    tmp_path: Path, smoothed: Result
) -> None:
    outputs = Outputs(tmp_path, "walk", ("parquet", "rrd"))
    write_outputs(smoothed, outputs)

    class Killed(BaseException):
        pass

    def killed(result: Result, recording: Recording) -> None:
        raise Killed

    with pytest.raises(Killed):
        write_outputs(smoothed, outputs, display=killed)
    assert [path.name for path in tmp_path.iterdir()] == ["walk.parquet"]


def test_a_recording_is_gathered_once(source: Source[Observations], monkeypatch: pytest.MonkeyPatch) -> None:
    """However many methods are compared and shown; the second run with the same parameters needs nothing anew. It is
    undistorted before that to see which views follow the person, and its limbs to see whose sides are exchanged, and
    which are on the other one."""
    undistorted: Counter[str] = Counter()
    triangulated: list[int] = []
    undistort, triangulate_robust = Camera.undistort, gather_module.triangulate_robust

    def counting_undistort(camera: Camera, points_px: np.ndarray) -> np.ndarray:
        undistorted[camera.name] += points_px.size
        return undistort(camera, points_px)

    def counting_triangulate(undistorted_px: np.ndarray, *arguments: Any, **options: Any) -> Triangulation:
        triangulated.append(undistorted_px.size)
        return triangulate_robust(undistorted_px, *arguments, **options)

    monkeypatch.setattr(Camera, "undistort", counting_undistort)
    for module in (gather_module, fusion):
        monkeypatch.setattr(module, "triangulate_robust", counting_triangulate)
    # Before and after, one is clipped to the image, and left out: what is left out is undistorted once more.
    source = Source(source.rig, source.observations.frames(slice(10, 15)))
    for result in (run_smooth(source, Config()), run_refine(source, Config())):
        with open_recording(None, source.rig, source.observations.skeleton, live=True, port=0) as recording:
            pipeline.show(result, recording)
    points2d_px = source.observations.points2d_px
    limbs_px = points2d_px[:, 0, limb_joints(source.observations.skeleton).ravel()]
    assert undistorted == dict.fromkeys(source.rig.names, 2 * (points2d_px[:, 0].size + limbs_px.size))
    assert triangulated == [points2d_px.size]


class Spy(Recording):
    """Remembers what is shown."""

    def __init__(self) -> None:
        self.shown: dict[str, Any] = {}

    def log_observations(
        self, observations: object, weights: object = None, undistorted_px: object = None, every: int = 1
    ) -> None:
        self.shown["weights"] = weights

    def log_trajectory(self, name: str, trajectory: object, every: int = 1) -> None:
        self.shown[name] = trajectory

    def log_residuals(self, time_s: object, residuals: object, every: int = 1) -> None:
        self.shown["residuals"] = residuals

    def log_update_times(self, time_s: object, update_ms: object) -> None:
        self.shown["update_ms"] = update_ms


def test_everything_is_shown(smoothed: Result, tracked: Result) -> None:
    spy = Spy()
    pipeline.show(smoothed, spy)
    assert set(spy.shown) == {"weights", "fused", "refined", "smoothed", "residuals"}
    spy = Spy()
    pipeline.show(tracked, spy)
    assert set(spy.shown) == {"weights", "online", "smoothed", "residuals", "update_ms"}


def test_of_a_long_recording_the_frames_are_compared_that_are_shown(
    source: Source[Observations], smoothed: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """20 frames, of which the viewer shows five: the same as where all are compared."""
    monkeypatch.setattr("fgpose.pipeline.outputs._MOST_SHOWN", 5)
    outputs = Outputs(tmp_path, "walk", ("rrd",))
    every = outputs.compared_every(source.observations.frame_time_s)
    assert every == 4
    result = run_smooth(source, Config(), compare=every)
    assert {name: people[0].n_frames for name, people in result.trajectories.items()} == {
        "fused": 5,
        "refined": 5,
        "smoothed": 20,
    }
    for name in ("fused", "smoothed"):
        whole = smoothed.trajectories[name][0]
        expected_m = whole.positions_m if name == "smoothed" else whole.positions_m[::every]
        np.testing.assert_array_equal(result.trajectories[name][0].positions_m, expected_m)
    write_outputs(result, outputs)
    of_some, of_all = Spy(), Spy()
    pipeline.show(result, of_some)
    pipeline.show(smoothed, of_all)
    np.testing.assert_array_equal(of_some.shown["weights"], of_all.shown["weights"][::every])
    for factor, values in of_all.shown["residuals"].items():
        np.testing.assert_array_equal(of_some.shown["residuals"][factor], values[::every])


def test_nothing_is_compared_that_nobody_sees(tmp_path: Path) -> None:
    assert Outputs(tmp_path, "walk", ("parquet",)).compared_every(np.arange(9.0)) == 0
    assert Outputs(tmp_path, "walk", ("rrd",), rrd_fps=1.0).compared_every(np.arange(9.0) / 60) == 1


def test_interrupted_viewer_leaves_no_file(tmp_path: Path, smoothed: Result) -> None:
    def interrupted(result: Result, recording: Recording) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_outputs(smoothed, Outputs(tmp_path, "walk", ("rrd",)), display=interrupted)
    assert list(tmp_path.iterdir()) == []


def test_outputs_are_checked_beforehand(tmp_path: Path) -> None:
    (tmp_path / "walk.trc").mkdir()
    with pytest.raises(OSError, match=r"walk\.trc: it is a folder"):
        Outputs(tmp_path, "walk", ("trc",)).check(("smoothed",))
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"):
        Outputs(tmp_path / "file", "walk", ("trc",)).check(("smoothed",))


def test_input_is_not_replaced(tmp_path: Path) -> None:
    outputs = Outputs(tmp_path, "walk", ("npz",))
    with pytest.raises(ValueError, match=r"walk\.npz would replace an input"):
        outputs.check(("smoothed",), (tmp_path / "walk.npz",))


def test_links_in_a_circle_are_an_input_like_any_other(tmp_path: Path) -> None:
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    Outputs(tmp_path / "out", "walk", ("npz",)).check(("smoothed",), (tmp_path / "circle",))


def test_cameras_are_chosen_on_both_sides(tmp_path: Path, source: Source[Observations]) -> None:
    save_rig(source.rig, tmp_path / "rig.npz")
    save_observations(source.observations, tmp_path / "all.npz")
    names = ("cam_04", "cam_02")
    loaded = load_source(tmp_path / "all.npz", tmp_path / "rig.npz", "body_25b", cameras=names)
    assert loaded.rig.names == loaded.observations.camera_names == names
    # The calibration may have cameras that the keypoints lack, if these are not chosen.
    save_observations(source.observations.subset(("cam_01", "cam_02")), tmp_path / "two.npz")
    loaded = load_source(tmp_path / "two.npz", tmp_path / "rig.npz", "body_25b", cameras=("cam_02", "cam_01"))
    assert loaded.rig.names == ("cam_02", "cam_01")
    with pytest.raises(ValueError, match="cam_09"):
        load_source(tmp_path / "all.npz", tmp_path / "rig.npz", "body_25b", cameras=("cam_09",))


def test_cameras_that_saw_nothing_and_are_not_wanted_do_not_count(tmp_path: Path, source: Source[Observations]) -> None:
    save_rig(source.rig, tmp_path / "rig.npz")
    save_observations(source.observations.subset(("cam_01", "cam_02", "cam_03")), tmp_path / "three.npz")
    loaded = load_source(tmp_path / "three.npz", tmp_path / "rig.npz", "body_25b", cameras=("cam_03", "cam_01"))
    assert loaded.rig.names == loaded.observations.camera_names == ("cam_03", "cam_01")
    with pytest.raises(ValueError, match="camera cam_04 of the calibration has no keypoints"):
        load_source(tmp_path / "three.npz", tmp_path / "rig.npz", "body_25b", cameras=("cam_04", "cam_01"))


def test_cameras_that_are_counted_otherwise_are_refused_where_they_are_wanted_all_the_same(
    tmp_path: Path, source: Source
) -> None:
    """Folders from 1, the calibration from 0: cam_1 of the one is cam_2 of the other."""
    from_0 = (replace(camera, name=f"cam_{c}") for c, camera in enumerate(source.rig.cameras))
    save_rig(CameraRig(tuple(from_0)), tmp_path / "rig.npz")
    save_observations(source.observations, tmp_path / "seen.npz")
    wanted = ("cam_1", "cam_2", "cam_3")
    with pytest.raises(ValueError, match="one seems to count from 1, the other from 0"):
        load_source(tmp_path / "seen.npz", tmp_path / "rig.npz", "body_25b")
    with pytest.raises(ValueError, match="cam_01 is cam_0, cam_02 is cam_1"):
        load_source(tmp_path / "seen.npz", tmp_path / "rig.npz", "body_25b", cameras=wanted)


def test_what_was_changed_to_read_keypoints_is_part_of_the_origin(tmp_path: Path, source: Source[Observations]) -> None:
    save_rig(source.rig, tmp_path / "rig.npz")
    for camera in source.rig.names:
        (tmp_path / "pose" / camera).mkdir(parents=True)
        person = {"pose_keypoints_2d": [300.0, 200.0, 1.2] * 25}
        (tmp_path / "pose" / camera / "000001.json").write_text(json.dumps({"people": [person]}))
    with pytest.warns(UserWarning, match="up to 1.20"):
        loaded = load_source(tmp_path / "pose", tmp_path / "rig.npz", "body_25b", fps=60.0)
    assert loaded.origin is not None
    assert loaded.origin.remarks == loaded.observations.remarks
    assert "up to 1.20" in loaded.origin.remarks[0]


@pytest.mark.parametrize("cameras", [(), ("cam_01", "cam_02")])
def test_a_misread_file_is_read_once_and_its_own_error_shown(
    tmp_path: Path, source: Source[Observations], cameras: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    save_rig(source.rig, tmp_path / "rig.npz")
    for camera in source.rig.names:
        (tmp_path / "pose" / camera).mkdir(parents=True)
        (tmp_path / "pose" / camera / "000001.json").write_text('{"people": [{"pose_keypoints_2d": [1, 2')
    read = []
    monkeypatch.setattr(detections, "read_content", lambda path: read.append(path.name) or read_content(path))
    with pytest.raises(ValueError, match=r"000001\.json, camera cam_01, frame 1: not JSON, or a truncated file"):
        load_source(tmp_path / "pose", tmp_path / "rig.npz", "body_25b", cameras=cameras, fps=60.0)
    assert read == ["000001.json"]


def test_whitened_residuals_are_in_sigmas(source: Source[Observations], smoothed: Result) -> None:
    config = Config()
    gathered, skeleton = gather(source.observations, source.rig, config), smoothed.main[0].skeleton
    evidence = informed(gathered, smoothed.main[0].positions_m, source.rig, skeleton, config)
    residuals = whitened_residuals(smoothed.main[0], evidence, source.rig, config)
    assert set(residuals) == {*(f"projection/cam_0{c}" for c in range(1, 5)), "symmetry", "motion"}
    assert smoothed.main[0].residual_px is not None
    expected = smoothed.main[0].residual_px[3, 0, 5] / evidence.sigma_px[3, 0, 5] * np.sqrt(evidence.weights[3, 0, 5])
    # sigmas are rounded to a thousandth
    assert residuals["projection/cam_01"][3, 5] == pytest.approx(expected, rel=6e-4)


def test_motion_residual_of_its_own_noise_is_about_one_sigma_per_axis(
    source: Source[Observations], smoothed: Result
) -> None:
    """White noise on the acceleration, integrated twice in fine steps: the residual's mean square is 3."""
    rng = np.random.default_rng(0)
    config, n_frames, fine = Config(motion={"adaptive": False}), 400, 50
    step_s = 1 / (60 * fine)
    shape = (n_frames * fine, 25, 3)
    acceleration = rng.normal(scale=np.sqrt(config.motion.acceleration_density / step_s), size=shape)
    positions_m = (np.cumsum(np.cumsum(acceleration, axis=0), axis=0) * step_s**2)[::fine]
    trajectory = replace(
        smoothed.main[0],
        time_s=np.arange(n_frames) / 60,
        positions_m=positions_m,
        status=np.full((n_frames, 25), Status.OBSERVED),
        covariance_m2=None,
        residual_px=None,
        visibility=None,
    )
    evidence = gather(source.observations, source.rig, config).frames(np.zeros(n_frames, dtype=int))
    motion = whitened_residuals(trajectory, evidence, source.rig, config)["motion"]
    # 10,000 values of mean square 3 and standard deviation about 2.5: 3 +- 0.1 is four standard errors.
    assert np.nanmean(motion**2) == pytest.approx(3.0, abs=0.1)


def test_a_recording_in_the_world_of_a_camera_stands_in_every_file(smoothed: Result, tmp_path: Path) -> None:
    """The real recording, once in a world with y down: the TRC stands, and says the same but for the heading."""
    world_R_up = z_up_R_world("-y").T
    rig = smoothed.source.rig.turned(world_R_up)
    source = Source(rig, smoothed.source.observations)
    turned = Result(source, smoothed.config, {"smoothed": {0: smoothed.main[0].turned(world_R_up)}}, ("smoothed",))
    write_outputs(smoothed, Outputs(tmp_path, "up", ("trc",)))
    with pytest.warns(UserWarning, match=r"down: the body stands along -y of the world, not along \+z"):
        write_outputs(turned, Outputs(tmp_path, "down", ("trc",)))
    # A finding says it, where there is a diagnosis.
    told = diagnosed(turned)
    assert told.diagnosis is not None
    assert "not along +z" in " ".join(each.text for each in told.diagnosis.findings)
    with warnings.catch_warnings(action="error"):
        write_outputs(told, Outputs(tmp_path, "told", ("trc",)))
    np.testing.assert_allclose(
        load_trajectory(tmp_path / "down.trc").positions_m, load_trajectory(tmp_path / "up.trc").positions_m, atol=1e-12
    )
    # What is said counts.
    write_outputs(turned, Outputs(tmp_path, "said", ("trc",), "-y"))
    assert (tmp_path / "said.trc").read_text().splitlines()[4:] == (tmp_path / "down.trc").read_text().splitlines()[4:]


@pytest.mark.parametrize("turns", [[0, -1, 1, 0], [1, 1, 1, 1]])
@pytest.mark.parametrize("turn_keypoints", [True, False])
def test_keypoints_of_images_turned_by_caliscope_are_noticed(
    source: Source[Observations], tmp_path: Path, turns: list[int], turn_keypoints: bool
) -> None:
    """Its calibration is that of the images as recorded, whatever rotation_count says."""
    rig = CameraRig(tuple(replace(each, name=f"cam_{n}") for n, each in enumerate(source.rig.cameras)))
    save_rig(rig, tmp_path / "rig.toml", "caliscope")
    parts = (tmp_path / "rig.toml").read_text().split("rotation_count = 0")
    text = parts[0] + "".join(f"rotation_count = {turn}{part}" for turn, part in zip(turns, parts[1:], strict=True))
    (tmp_path / "rig.toml").write_text(text)
    points_px = source.observations.points2d_px.copy()
    for camera, turn in enumerate(turns if turn_keypoints else []):
        x, y = points_px[:, camera, :, 0].copy(), points_px[:, camera, :, 1].copy()
        width, height = rig.cameras[camera].size_px
        if turn:
            points_px[:, camera] = np.stack([height - 1 - y, x] if turn == 1 else [y, width - 1 - x], axis=-1)
    seen = replace(source.observations, points2d_px=points_px, camera_names=rig.names)
    save_observations(seen, tmp_path / "seen.npz")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        loaded = load_source(tmp_path / "seen.npz", tmp_path / "rig.toml", source.observations.skeleton)
    assert bool(caught) == turn_keypoints
    errors_px = []
    for each in (source, loaded):
        undistorted_px = each.rig.undistort(each.observations.points2d_px)
        positions_m = triangulate_robust(undistorted_px, each.observations.confidence, each.rig).positions_m
        errors_px.append(np.nanmedian(reprojection_residual_px(undistorted_px, each.rig, positions_m)))
    # Turning the images changes nothing but for rounding in the file, 1e-4 px.
    assert errors_px[1] == pytest.approx(errors_px[0], abs=1e-2)


@pytest.mark.parametrize(("shift_sigma_m", "said"), [(0.067, True), (0.006, False)])
def test_a_refinement_that_may_have_shifted_the_world_is_said(
    source: Source[Observations],
    smoothed: Result,
    shift_sigma_m: float,
    said: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """6 mm are those of cameras that are as right as the parameters expect. More than a note, it comes first."""
    note = Finding(Code.HALLUCINATING_CAMERA, Severity.NOTE, "some are", "Look at its images.", 0.9)
    monkeypatch.setattr("fgpose.pipeline.diagnosed.looked_at", lambda *given: Diagnosis((note,), (), {}))
    origin = Origin(calibration=CalibrationOrigin(shift_sigma_m=shift_sigma_m))
    result = diagnosed(replace(smoothed, source=replace(source, origin=origin)))
    assert result.diagnosis is not None
    found = [each.reason for each in result.diagnosis.findings if each.code is Code.CALIBRATION]
    assert ["is known to 67 mm along each axis" in each for each in found] == [True] * said
    assert result.diagnosis.worst is (Severity.DOUBTFUL if said else Severity.NOTE)


@pytest.mark.slow
def test_failures_of_gtsam_are_said_where_there_were_some(
    source: Source[Observations], tracked: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    def findings(result: Result) -> list[str]:
        diagnosis = diagnosed(result).diagnosis
        assert diagnosis is not None
        return [each.reason for each in diagnosis.findings if each.code is Code.SOLVER_FAILURE]

    assert findings(tracked) == []
    counts = iter(np.minimum(np.arange(20), 3).tolist())
    monkeypatch.setattr(Window, "repairs", property(lambda _: next(counts)))
    (reason,) = findings(run_track(source, SHORT_LAG))
    assert reason.startswith("GTSAM has failed 3 times")


@pytest.mark.usefixtures("with_search_for_faults")
def test_advice_that_was_followed_is_not_given_again(source: Source[Observations], smoothed: Result) -> None:
    def remedies(estimated: tuple[str, ...]) -> set[str]:
        result = replace(smoothed, source=replace(source, origin=Origin(rig=source.rig, estimated=estimated)))
        diagnosis = diagnosed(result).diagnosis
        assert diagnosis is not None
        return {each.remedy for each in diagnosis.findings if each.code is Code.MOVED_CAMERA}

    (advice,) = remedies(())
    assert advice == "Use --refine-calibration."
    assert remedies(("clocks",)) == {advice}
    (other,) = remedies(("poses",))
    assert "estimated on this recording already" in other
    assert "--refine-calibration" not in other


@pytest.mark.parametrize(("poses", "clocks"), [(True, False), (False, True)])
def test_a_result_knows_what_was_estimated_of_its_cameras(
    source: Source[Observations], poses: bool, clocks: bool
) -> None:
    given = replace(source, origin=Origin(rig=source.rig))
    calibrated, _ = run_calibrate(given, Config(calibration={"max_rounds": 1}), poses=poses, clocks=clocks)
    assert calibrated.origin is not None
    assert calibrated.origin.estimated == ("poses",) * poses + ("clocks",) * clocks
