"""When nobody is seen, or unsurely, or always the same."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

import fgpose
from fgpose.diagnosis.clock_checks import pauses
from fgpose.diagnosis.examined import Examined
from fgpose.diagnosis.seen import interpolated, keypoints, order
from fgpose.diagnosis.seen.interpolated import interpolated_keypoints
from fgpose.diagnosis.seen.keypoints import low_confidence, smoothed_keypoints
from fgpose.diagnosis.seen.order import sorted_as_text
from fgpose.diagnosis.seen.placeholders import Placeholders
from fgpose.diagnosis.seen.presence import blind, identity_switches, never_seen, nobody, seen_elsewhere
from fgpose.diagnosis.seen.repeated import frozen_cameras, repeated_images
from fgpose.diagnosis.seen.things import Things
from fgpose.finding import Code, Severity
from fgpose.geometry.camera import CameraRig
from fgpose.observations import Observations
from fgpose.sampling import parts_of
from fgpose_benchmarks.synthetic import walking
from tests.fgpose.diagnosis.damaged import SKELETON, motion_m, recorded, room, with_points


@pytest.fixture(scope="module")
def rig() -> CameraRig:
    return room(3, seed=3)


def without(seen: Observations, frames: slice, cameras: slice = slice(None)) -> Observations:
    """Five seconds at 30 Hz, of which some cameras see nothing for some."""
    points_px = seen.points2d_px.copy()
    points_px[frames, cameras] = np.nan
    return with_points(seen, points_px)


def test_nothing_is_told_of_somebody_who_is_always_seen(seen, rig) -> None:
    examined = Examined.of(seen, rig)
    assert [
        *nobody(examined),
        *low_confidence(examined),
        *frozen_cameras(examined),
        *repeated_images(examined),
        *smoothed_keypoints(examined),
        *interpolated_keypoints(examined),
        *sorted_as_text(examined),
        *Placeholders.among(examined).findings(examined),
        *Things.among(examined).findings(examined),
    ] == []


def test_nothing_is_told_of_a_real_recording() -> None:
    rig, seen = fgpose.files.load_recording("balance_openpose")
    examined = Examined.of(seen, rig)
    assert [
        *nobody(examined),
        *low_confidence(examined),
        *frozen_cameras(examined),
        *repeated_images(examined),
        *smoothed_keypoints(examined),
        *interpolated_keypoints(examined),
        *sorted_as_text(examined),
        *Placeholders.among(examined).findings(examined),
        *Things.among(examined).findings(examined),
    ] == []


def test_when_nobody_is_there(seen, rig) -> None:
    (finding,) = nobody(Examined.of(without(seen, slice(30, 90)), rig))
    assert (finding.code, finding.severity) == (Code.NOBODY, Severity.NOTE)
    assert finding.from_s == pytest.approx(1.0)
    assert finding.to_s == pytest.approx(3.0)
    assert finding.numbers["share"] == pytest.approx(0.4)


@pytest.mark.parametrize("hole_s", [2.0, 86400.0])
def test_a_recording_that_was_paused(seen, rig, hole_s: float) -> None:
    assert pauses(Examined.of(seen, rig)) == []
    time_s = seen.time_s + np.where(np.arange(seen.n_frames) < 60, 0.0, hole_s)
    (finding,) = pauses(Examined.of(replace(seen, time_s=time_s), rig))
    assert (finding.code, finding.severity) == (Code.MISSING_FRAMES, Severity.NOTE)
    assert f"for {hole_s + 1 / 30:.2f} s at {59 / 30:.1f} s" in finding.reason


def test_stretches_without_anybody_of_less_than_a_second_count_too(seen, rig) -> None:
    (finding,) = nobody(Examined.of(without(without(seen, slice(30, 90)), slice(100, 115)), rig))
    assert finding.numbers["share"] == pytest.approx(75 / seen.n_frames, abs=1e-6)
    assert finding.reason.endswith("in 50 % of the time: 1.0 to 3.0 s, 3.3 to 3.8 s")


def test_single_frames_without_anybody_are_not_listed(seen, rig) -> None:
    """As those of one camera whose image is of nobody who is followed, where the others were left out."""
    lacking = without(without(seen, slice(30, 90)), slice(100, 104, 2))
    (finding,) = nobody(Examined.of(lacking, rig))
    assert finding.reason == "The person is in no image in 40 % of the time: 1.0 to 3.0 s"


def test_when_one_camera_is_alone(seen, rig) -> None:
    (finding,) = nobody(Examined.of(without(seen, slice(75, None), slice(1, None)), rig))
    assert (finding.code, finding.severity) == (Code.FEW_CAMERAS, Severity.DOUBTFUL)
    assert "50 % of the time: 2.5 to 5.0 s" in finding.reason


def test_joints_that_two_cameras_never_see_at_once(seen, rig) -> None:
    """With the 3D of a view they are estimated."""
    alone = np.zeros(seen.seen.shape, dtype=bool)
    alone[:, 1:, SKELETON.index("left_wrist")] = True
    own_3d = seen.without(alone)
    (missing,) = never_seen(Examined.of(replace(own_3d, points3d_m=None, covariance3d_m2=None), rig))
    assert missing.reason.endswith("so not estimated: left wrist")
    (of_one_view,) = never_seen(Examined.of(own_3d, rig))
    assert of_one_view.reason.endswith("so estimated from the 3D of one view alone: left wrist")
    result = fgpose.smooth(own_3d.first_frames(30), rig)
    assert np.isfinite(result.positions_m[:, SKELETON.index("left_wrist")]).all()
    assert never_seen(Examined.of(seen.subset(["cam1"]), rig.subset(["cam1"]))) == []


def test_legs_that_the_network_guesses(seen, rig) -> None:
    legs = [SKELETON.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("knee", "ankle")]
    confidence = seen.confidence.copy()
    confidence[:, :, legs] = 0.05
    (finding,) = low_confidence(Examined.of(replace(seen, confidence=confidence), rig))
    assert (finding.code, finding.severity) == (Code.LOW_CONFIDENCE, Severity.DOUBTFUL)
    assert "unsure of knees and ankles throughout" in finding.reason
    assert "--min-confidence 0.10 " in finding.remedy


def test_joints_whose_claims_are_wide_for_their_confidence(seen, rig) -> None:
    """Half of what other joints have: 0.05 to 0.3 m were stated for 0.01, and nothing was said."""
    wrists, confidence = [SKELETON.index(f"{side}_wrist") for side in ("left", "right")], seen.confidence.copy()
    confidence[:, :, wrists] *= 0.5
    (finding,) = low_confidence(Examined.of(replace(seen, confidence=confidence), rig))
    assert (finding.code, finding.severity) == (Code.LOW_CONFIDENCE, Severity.NOTE)
    assert "less sure of wrists than of other joints" in finding.reason
    assert low_confidence(Examined.of(seen, rig)) == []


def test_an_image_that_stands_still(seen, rig) -> None:
    points_px = seen.points2d_px.copy()
    points_px[60:120, 1] = points_px[60, 1]
    (finding,) = frozen_cameras(Examined.of(with_points(seen, points_px), rig))
    assert (finding.code, finding.severity, finding.camera) == (Code.FROZEN_CAMERA, Severity.WRONG, "cam2")
    assert finding.from_s == pytest.approx(2.0)
    assert finding.to_s == pytest.approx(119 / 30)


def test_a_camera_of_a_lower_rate_is_not_blind(seen, rig) -> None:
    """Two of three frames have no image of it, and none that shows nobody."""
    time_s = np.repeat(seen.time_s[:, None], rig.n_cameras, axis=1)
    without = np.arange(seen.n_frames) % 3 > 0
    hidden = np.zeros(seen.confidence.shape, dtype=bool)
    hidden[without, 0] = True
    assert blind(Examined.of(seen.without(hidden), rig))[0].numbers["share"] < 0.4
    time_s[without, 0] = np.nan
    assert blind(Examined.of(replace(seen.without(hidden), time_s=time_s), rig)) == []


def test_a_camera_is_not_blind_while_nobody_is_there(seen, rig) -> None:
    """Somebody in one of five seconds; a camera that misses most of that still is."""
    shortly = without(seen, slice(30, None))
    assert blind(Examined.of(shortly, rig)) == []
    (finding,) = blind(Examined.of(without(shortly, slice(6, None), slice(2, 3)), rig))
    # Of six frames of the thirty, and of the half second after that another image may be of.
    assert (finding.camera, finding.numbers["share"] < 0.2) == (rig.names[2], True)


def test_no_camera_is_blind_where_all_see_as_little(seen, rig) -> None:
    """A whole body is expected, and a desk hides most of it from every camera."""
    hidden = np.zeros(seen.confidence.shape, dtype=bool)
    hidden[:, :, ::2] = hidden[:, :, 1::8] = True
    assert blind(Examined.of(seen.without(hidden), rig)) == []
    hidden[:60, 1] = True
    (finding,) = blind(Examined.of(seen.without(hidden), rig))
    assert finding.camera == rig.names[1]


def test_who_is_shown_by_others_alone_makes_no_camera_blind(seen, rig) -> None:
    """A reflection in two of the cameras, or somebody outside of the view of the others."""
    hidden = np.zeros(seen.confidence.shape, dtype=bool)
    hidden[:, 0] = True
    both = Examined(rig, {0: seen, 1: seen.without(hidden)})
    assert blind(both) == []
    (finding,) = blind(Examined(rig, {0: seen.without(hidden)}))
    assert finding.camera == rig.names[0]


def test_a_camera_that_was_bumped_is_not_blind(seen, rig) -> None:
    """On the common clock it is two, each of which sees its part of the time."""
    moved = replace(rig.cameras[0], moves=((2.5, rig.cameras[0].world_T_camera),))
    pieces, in_pieces = fgpose.calibration.on_common_clock(seen, fgpose.CameraRig((moved, *rig.cameras[1:])))
    assert in_pieces.n_cameras == rig.n_cameras + 1
    assert blind(Examined.of(pieces, in_pieces)) == []


@pytest.mark.parametrize(
    ("cameras", "severity"), [((1,), Severity.DOUBTFUL), pytest.param((0, 1), Severity.WRONG, marks=pytest.mark.slow)]
)
def test_somebody_else_at_first(cameras: tuple[int, ...], severity: Severity) -> None:
    """One camera is outvoted; of two against two it is not told who is right."""
    rig = room(4)
    seen = recorded(rig)
    elsewhere = recorded(rig, motion_m() + np.array([1.2, 0.4, 0.0]), seed=5)
    at_first = np.arange(seen.n_frames) < 0.3 * seen.n_frames
    points_px = seen.points2d_px.copy()
    for c in cameras:
        points_px[at_first, c] = elsewhere.points2d_px[at_first, c]
    assert seen_elsewhere(Examined(rig, {0: seen}), ()) == []
    given = Examined(rig, {0: with_points(seen, points_px)})
    (finding,) = seen_elsewhere(given, ())
    assert (finding.code, finding.severity) == (Code.DISAGREEING_CAMERA, severity)
    assert 25 <= 100 * finding.numbers["share"] <= 35  # of 30 %
    assert seen_elsewhere(given, rig.names) == []


def test_views_that_miss_the_person_one_after_the_other_are_outvoted() -> None:
    """Of each image it is told which camera is wrong, although of the whole recording it is every one of them."""
    rig = room(4)
    given = Examined(rig, {0: recorded(rig, seed=2, detector="blazepose_full")})
    (finding,) = seen_elsewhere(given, ())
    assert (finding.code, finding.severity, finding.camera) == (Code.DISAGREEING_CAMERA, Severity.NOTE, "")
    assert finding.numbers["share"] > 0.1 > finding.numbers["share_untold"]


def test_a_view_that_goes_over_to_somebody_else() -> None:
    rig = room(4)
    seen, beside = recorded(rig), recorded(rig, motion_m() + np.array([1.0, 1.0, 0.0]), seed=5)
    points_px = seen.points2d_px.copy()
    points_px[60:90, :2] = beside.points2d_px[60:90, :2]
    assert identity_switches(Examined(rig, {0: seen})) == []
    found = identity_switches(Examined(rig, {0: with_points(seen, points_px)}))
    assert [(each.code, each.severity, each.camera) for each in found] == [
        (Code.IDENTITY_SWITCH, Severity.DOUBTFUL, name) for name in rig.names[:2]
    ]
    for each in found:
        assert "2.0 to 3.0 s" in each.reason
        assert each.numbers["total_s"] == pytest.approx(29 / 30)


@pytest.mark.parametrize(
    ("shown", "words", "true_hz"),
    [
        (np.arange(150) // 2 * 2, "each image comes 2 times", 15),
        (np.arange(150) // 4 * 4, "each image comes 4 times", 7.5),
        (np.arange(150) - (np.arange(150) % 6 == 5), "17 % of the images are repeated", 25),
    ],
)
def test_images_that_are_repeated(seen, rig, shown: np.ndarray, words: str, true_hz: float) -> None:
    points_px = seen.points2d_px.copy()
    points_px[:, 1] = points_px[shown, 1]
    (finding,) = repeated_images(Examined.of(with_points(seen, points_px), rig))
    assert (finding.code, finding.severity, finding.camera) == (Code.REPEATED_IMAGES, Severity.DOUBTFUL, "cam2")
    assert words in finding.reason
    assert finding.numbers["true_hz"] == pytest.approx(true_hz, rel=0.02)  # the first and the last are cut off
    everywhere = with_points(seen, seen.points2d_px[shown])
    (finding,) = repeated_images(Examined.of(everywhere, rig))
    assert finding.reason.startswith("Of all cameras")
    assert frozen_cameras(Examined.of(everywhere, rig)) == []


def test_coarse_numbers_of_somebody_who_hardly_moves_are_no_repetitions(seen, rig) -> None:
    still_px = seen.points2d_px[:1] + 0.02 * (seen.points2d_px - seen.points2d_px[:1])
    assert repeated_images(Examined.of(with_points(seen, np.round(still_px)), rig)) == []


def test_confidences_of_zero_are_said(seen, rig) -> None:
    diagnosis = fgpose.diagnose(replace(seen, confidence=np.zeros(seen.confidence.shape)), rig)
    assert diagnosis.findings[0].reason.startswith("No camera has a detection: all keypoints are missing, or have conf")


def test_missing_joints_that_are_written_as_zero(seen, rig) -> None:
    points_px, legs = seen.points2d_px.copy(), [SKELETON.index(f"{side}_knee") for side in ("left", "right")]
    points_px[:, :, legs] = 0.0
    confidence = np.where(np.isin(np.arange(SKELETON.n_joints), legs), 0.5, seen.confidence)
    zeros = replace(seen, points2d_px=points_px, confidence=confidence)
    diagnosis = fgpose.diagnose(zeros, rig)
    (finding,) = [each for each in diagnosis.findings if each.severity is not Severity.NOTE]
    assert (finding.code, finding.severity) == (Code.ZERO_KEYPOINTS, Severity.WRONG)
    assert "They are of knees, in all cameras" in finding.reason
    assert finding.numbers["share"] == pytest.approx(2 / SKELETON.n_joints, rel=0.05)  # but for what is not detected


def with_placeholders(seen: Observations, place: tuple[float, float]) -> Observations:
    """A tenth of all, which a lens that distorts would explain."""
    missing = np.random.default_rng(0).random(seen.confidence.shape) < 0.1
    points_px = np.where(missing[..., None], place, seen.points2d_px)
    return replace(seen, points2d_px=points_px, confidence=np.where(missing, 0.5, seen.confidence))


@pytest.mark.parametrize("place", [(-1.0, -1.0), (9999.0, 9999.0), (800.0, 600.0)])
def test_missing_joints_that_are_written_as_a_number(seen, rig, place: tuple[float, float]) -> None:
    examined = Examined.of(with_placeholders(seen, place), rig)
    placeholders = Placeholders.among(examined)
    (finding,) = placeholders.findings(examined)
    assert (finding.code, finding.severity) == (Code.PLACEHOLDER_KEYPOINTS, Severity.DOUBTFUL)
    assert f"exactly ({place[0]:g}, {place[1]:g})" in finding.reason
    assert finding.numbers["share"] == pytest.approx(0.1, abs=0.01)
    assert not (placeholders.as_missing(examined).main.points2d_px == np.array(place)).all(axis=-1).any()


@pytest.mark.slow
def test_what_is_written_as_a_number_is_no_cause_of_anything_else(seen, rig) -> None:
    found = fgpose.diagnose(with_placeholders(seen, (-1.0, -1.0)), rig).findings
    assert [each.code for each in found if each.severity is not Severity.NOTE] == [Code.PLACEHOLDER_KEYPOINTS]


@pytest.mark.parametrize("pixels", [1.0, 8.0])
def test_coarse_numbers_are_no_placeholders(seen, rig, pixels: float) -> None:
    """Of a heat map, say: joints of somebody who stands are at one place for long, and neighbours at the same."""
    still_px = seen.points2d_px[:1] + 0.1 * (seen.points2d_px - seen.points2d_px[:1])
    coarse = with_points(seen, pixels * np.round(still_px / pixels))
    assert not Placeholders.among(Examined.of(coarse, rig)).of
    frozen = with_points(seen, np.broadcast_to(seen.points2d_px[:1], seen.points2d_px.shape).copy())
    assert not Placeholders.among(Examined.of(frozen, rig)).of


def filled(points_px: np.ndarray, gaps: list[slice], cameras: list[int]) -> np.ndarray:
    """With straight lines over gaps."""
    whole_px = points_px.copy()
    for gap in gaps:
        share = (np.arange(gap.start, gap.stop) - gap.start + 1)[:, None, None, None] / (gap.stop - gap.start + 1)
        whole_px[gap, cameras] = (1 - share) * points_px[gap.start - 1, cameras] + share * points_px[gap.stop, cameras]
    return whole_px


@pytest.mark.parametrize(("cameras", "name", "decimals"), [([0, 1, 2], "", 15), ([1], "cam2", 2)])
def test_gaps_that_were_interpolated(seen, rig, cameras: list[int], name: str, decimals: int) -> None:
    points_px = filled(seen.points2d_px, [slice(30, 36), slice(90, 108)], cameras).round(decimals)
    (finding,) = interpolated_keypoints(Examined.of(with_points(seen, points_px), rig))
    assert (finding.code, finding.severity, finding.camera) == (Code.INTERPOLATED_KEYPOINTS, Severity.WRONG, name)
    # But for joints that were not detected where a line begins or ends, or hardly move along it.
    assert 0.7 * 24 / 150 <= finding.numbers["share"] <= 24 / 150 * 1.1
    assert finding.numbers["longest_s"] == pytest.approx(18 / 30)
    assert f"at {90 / 30:.2f} s" in finding.reason


def test_keypoints_that_were_interpolated_to_a_higher_rate(seen, rig) -> None:
    points_px = seen.points2d_px.copy()
    points_px[1:-1:2] = (points_px[:-2:2] + points_px[2::2]) / 2
    (finding,) = interpolated_keypoints(Examined.of(with_points(seen, points_px), rig))
    assert finding.severity is Severity.DOUBTFUL
    assert finding.numbers["share"] == pytest.approx(0.5, abs=0.05)


def test_coarse_numbers_and_somebody_who_glides_are_not_called_interpolated(seen, rig) -> None:
    slow_m = gaussian_filter1d(motion_m(), 0.4 * 30, axis=0)
    exact_px = np.stack([each.distort(each.project(slow_m)) for each in rig.cameras], axis=1)
    for points_px in (
        np.round(seen.points2d_px),
        *(np.round(exact_px, decimals) for decimals in range(4)),
        exact_px,
        seen.points2d_px.astype(np.float32),
    ):
        assert interpolated_keypoints(Examined.of(with_points(seen, points_px.astype(float)), rig)) == []


@pytest.mark.slow
def test_what_is_zero_by_chance_is_no_cause_of_anything_else(seen, rig) -> None:
    """A third of all: rays through the corner, of a camera that looks moved."""
    zero = np.random.default_rng(0).random(seen.confidence.shape) < 0.3
    points_px = np.where(zero[..., None], 0.0, seen.points2d_px)
    zeros = replace(seen, points2d_px=points_px, confidence=np.where(zero, 0.5, seen.confidence))
    (finding,) = [each for each in fgpose.diagnose(zeros, rig).findings if each.severity is not Severity.NOTE]
    assert (finding.code, finding.severity) == (Code.ZERO_KEYPOINTS, Severity.DOUBTFUL)
    assert finding.numbers["share"] == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize("solver", ["batch", "online"])
def test_joints_beyond_the_image_that_are_clipped(seen, rig, solver: str) -> None:
    """One camera does not see the legs, which stand on the border of its image: as if nothing was detected there."""
    size_px = 1920, 640
    cut = CameraRig(tuple(replace(each, size_px=size_px) if c == 0 else each for c, each in enumerate(rig.cameras)))
    points_px, beyond = seen.points2d_px.copy(), seen.points2d_px[:, 0, :, 1] > size_px[1] - 1
    points_px[:, 0] = np.minimum(points_px[:, 0], np.array(size_px) - 1.0)
    clipped = with_points(seen, points_px)
    beyond &= clipped.seen[:, 0]
    missing = clipped.without(np.pad(beyond[:, None], ((0, 0), (0, rig.n_cameras - 1), (0, 0))))
    assert beyond.mean() > 0.2
    if solver == "online":
        estimators = fgpose.Estimator(cut, SKELETON), fgpose.Estimator(cut, SKELETON)
        for one, other in zip(clipped.frames(slice(0, 10)), missing.frames(slice(0, 10)), strict=True):
            found, wanted = estimators[0].update(one), estimators[1].update(other)
            np.testing.assert_array_equal(found.positions_m, wanted.positions_m)
            assert found.visibility is not None
            assert (found.visibility[0][beyond[found.frame]] == 0).all()
        return
    found, wanted = fgpose.smooth(clipped, cut), fgpose.smooth(missing, cut)
    np.testing.assert_array_equal(found.positions_m, wanted.positions_m)
    assert found.visibility is not None
    assert (found.visibility[:, 0][beyond] == 0).all()
    (finding,) = [each for each in fgpose.diagnose(clipped, cut, found).findings if each.code == Code.CLIPPED_KEYPOINTS]
    assert finding.reason.endswith("They are in cam1")
    of_missing = fgpose.diagnose(missing, cut, wanted)
    assert not of_missing.tells_of(Code.CLIPPED_KEYPOINTS)
    # Of the ankles, which stand there in most images, one camera was said to exchange left and right.
    codes = {each.code for each in fgpose.diagnose(clipped, cut, found).findings}
    assert codes == {each.code for each in of_missing.findings} | {Code.CLIPPED_KEYPOINTS}


@pytest.mark.parametrize("cameras", [[0, 1, 2], [1]])
def test_keypoints_that_were_smoothed(seen, rig, cameras: list[int]) -> None:
    points_px = seen.points2d_px.copy()
    points_px[:, cameras] = gaussian_filter1d(points_px[:, cameras], 0.4 * 30, axis=0)
    (finding,) = smoothed_keypoints(Examined.of(with_points(seen, points_px), rig))
    assert (finding.code, finding.severity) == (Code.SMOOTHED_KEYPOINTS, Severity.DOUBTFUL)
    assert finding.camera == ("" if len(cameras) == 3 else "cam2")


def test_smoothed_keypoints_of_one_camera_are_noted(seen, rig) -> None:
    alone = seen.subset(["cam1"])
    points_px = gaussian_filter1d(alone.points2d_px, 0.4 * 30, axis=0)
    (finding,) = smoothed_keypoints(Examined.of(with_points(alone, points_px), rig.subset(["cam1"])))
    assert finding.severity is Severity.NOTE


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_keypoints_that_went_through_a_causal_filter_are_noted(seen, rig, share: float) -> None:
    points_px = lfilter([share], [1, share - 1], seen.points2d_px, axis=0)[30:]
    filtered = replace(
        seen, points2d_px=points_px, confidence=seen.confidence[30:], time_s=seen.time_s[30:], points3d_m=None
    )
    (finding,) = smoothed_keypoints(Examined.of(filtered, rig))
    assert finding.severity is Severity.NOTE
    assert "probably filtered" in finding.reason


def test_what_is_filtered_lightly_is_noted_and_what_has_no_errors_is_not(seen, rig) -> None:
    lightly_px = gaussian_filter1d(seen.points2d_px, 0.025 * 30, axis=0)
    (finding,) = smoothed_keypoints(Examined.of(with_points(seen, lightly_px), rig))
    assert finding.severity is Severity.NOTE
    assert smoothed_keypoints(Examined.of(seen, rig)) == []
    slow_m = gaussian_filter1d(motion_m(), 0.4 * 30, axis=0)
    exact_px = np.stack([each.distort(each.project(slow_m)) for each in rig.cameras], axis=1)
    assert smoothed_keypoints(Examined.of(with_points(seen, exact_px), rig)) == []


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize(("cameras", "where"), [((1,), "cam2"), ((0, 1, 2), "all cameras")])
def test_files_that_were_sorted_as_text(seen, rig, first: int, cameras: tuple[int, ...], where: str) -> None:
    as_text = np.array(sorted(range(first, first + seen.n_frames), key=str)) - first
    points_px = seen.points2d_px.copy()
    for c in cameras:
        points_px[:, c] = points_px[as_text, c]
    (finding,) = sorted_as_text(Examined.of(with_points(seen, points_px), rig))
    assert (finding.code, finding.severity) == (Code.FRAME_ORDER, Severity.WRONG)
    assert f"The images of {where} were sorted" in finding.reason


def test_a_robot_that_is_taken_for_the_person(rig) -> None:
    """In one camera, at first and once again later; what is left is the person."""
    seen = recorded(rig, walking(150, 30.0), seed=3)
    thing_px = 0.7 * seen.points2d_px[0, 1] + np.array([300.0, 100.0])
    of_robot = np.arange(150) < 75
    of_robot[100:106] = True
    points_px = seen.points2d_px.copy()
    points_px[of_robot, 1] = thing_px + np.random.default_rng(0).normal(0, 2, (of_robot.sum(), *thing_px.shape))
    examined = Examined.of(with_points(seen, points_px), rig)
    things = Things.among(examined)
    (finding,) = things.findings(examined)
    assert (finding.code, finding.severity, finding.camera) == (Code.THING_FOR_PERSON, Severity.DOUBTFUL, "cam2")
    assert (finding.from_s, finding.to_s) == (0.0, pytest.approx(74 / 30))
    assert (things.as_missing(examined).main.seen[:, 1].any(axis=1) == ~of_robot).all()


def test_an_image_that_stands_still_is_in_order(seen, rig) -> None:
    points_px = seen.points2d_px.copy()
    points_px[50:] = points_px[50]
    assert sorted_as_text(Examined.of(with_points(seen, points_px), rig)) == []


def test_what_is_looked_at_in_parts_is_told_as_of_the_whole(seen, rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a joint is not seen too, and in a last part of two images."""
    as_text = np.array(sorted(range(seen.n_frames), key=str))
    damaged_px = [
        filled(seen.points2d_px, [slice(30, 36), slice(90, 108)], [1]),
        gaussian_filter1d(seen.points2d_px, 0.4 * 30, axis=0),
        seen.points2d_px[as_text],
    ]
    for points_px in damaged_px:
        points_px[20:26, 0, :4] = np.nan
    checks = interpolated_keypoints, smoothed_keypoints, sorted_as_text
    recordings = [Examined.of(with_points(seen, points_px), rig) for points_px in damaged_px]
    whole = [check(each) for each in recordings for check in checks]
    assert {finding.code for found in whole for finding in found} == {
        Code.INTERPOLATED_KEYPOINTS,
        Code.SMOOTHED_KEYPOINTS,
        Code.FRAME_ORDER,
    }
    for module in (interpolated, keypoints, order):
        monkeypatch.setattr(module, "parts_of", partial(parts_of, at_once=7))
    assert [check(each) for each in recordings for check in checks] == whole


def test_images_that_stand_still_and_clocks_that_differ_are_no_things(rig) -> None:
    """One camera shows somebody walk when two show somebody stand; or its images are the same."""
    stands_m = np.concatenate([np.repeat(walking(1, 30.0), 75, axis=0), walking(75, 30.0)])
    seen = recorded(rig, stands_m, seed=3)
    points_px = seen.points2d_px.copy()
    points_px[:, 0] = np.roll(points_px[:, 0], 75, axis=0)
    assert Things.among(Examined.of(with_points(seen, points_px), rig)).of == {}
    points_px = recorded(rig, walking(150, 30.0), seed=3).points2d_px.copy()
    points_px[40:, 1] = points_px[40, 1]
    assert Things.among(Examined.of(with_points(seen, points_px), rig)).of == {}


def test_somebody_who_stands_still_is_no_thing(rig) -> None:
    stands_m = np.concatenate([np.repeat(walking(1, 30.0), 75, axis=0), walking(75, 30.0)])
    assert Things.among(Examined.of(recorded(rig, stands_m, seed=3), rig)).of == {}
