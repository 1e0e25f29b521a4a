from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import motmetrics
import numpy as np
import pytest
from made_up_people import FPS, People, make, only, people, scene, standing

from fgpose.assessment.people import evaluate_people, revised
from fgpose.association.track import TrackEvent
from fgpose.skeleton import Skeleton


def frames_of(estimate: People, truth: People) -> Iterator[tuple[dict[int, np.ndarray], dict[int, np.ndarray]]]:
    """Who is where in each frame of the truth; all times are whole frames."""
    for frame in range(next(iter(truth.values())).n_frames):
        sides = []
        for side in (estimate, truth):
            rows = {n: np.flatnonzero(np.round(each.time_s * FPS) == frame) for n, each in sorted(side.items())}
            poses_m = {n: side[n].positions_m[row[0]] for n, row in rows.items() if len(row)}
            sides.append({n: pose_m for n, pose_m in poses_m.items() if np.isfinite(pose_m).any()})
        yield sides[0], sides[1]


def distance_m(a_m: np.ndarray, b_m: np.ndarray) -> float:
    errors_m = [np.linalg.norm(a - b) for a, b in zip(a_m, b_m, strict=True) if np.isfinite(a + b).all()]
    return float(np.mean(errors_m)) if errors_m else np.nan


def with_motmetrics(estimate: People, truth: People, match_m: float) -> dict[str, float]:
    accumulator = motmetrics.MOTAccumulator(auto_id=True)
    for found_m, real_m in frames_of(estimate, truth):
        gaps_m = np.array([[distance_m(a, b) for b in found_m.values()] for a in real_m.values()])
        accumulator.update(list(real_m), list(found_m), np.where(gaps_m < match_m, gaps_m, np.nan))
    names = ["num_switches", "num_fragmentations", "mota", "idf1", "idp", "idr", "recall", "precision"]
    table = motmetrics.metrics.create().compute(accumulator, metrics=names)
    return {name: float(table[name].iloc[0]) for name in names}


@pytest.mark.parametrize("match_m", [0.3, 0.5])
@pytest.mark.parametrize("seed", range(4))
def test_clear_mot_and_idf1_agree_with_motmetrics(seed, match_m):
    estimate, truth = scene(seed, n_people=6, n_frames=100)
    expected = with_motmetrics(estimate, truth, match_m)
    assert expected["num_switches"] > 5
    assert expected["num_fragmentations"] > 5
    assert 0.2 < expected["idf1"] < 0.9
    scores = evaluate_people(estimate, truth, match_m=match_m)
    assert scores.switches == sum(person.switches for person in scores.people) == expected["num_switches"]
    assert scores.fragmentations == expected["num_fragmentations"]
    for name in ("mota", "idf1", "idp", "idr", "recall", "precision"):
        # the same counts, divided in another order
        assert getattr(scores, name) == pytest.approx(expected[name], rel=1e-12), name
    n_there = sum(person.n_frames for person in scores.people)
    assert scores.recall == pytest.approx(sum(p.recall * p.n_frames for p in scores.people) / n_there)
    assert scores.f1 == pytest.approx(2 / (1 / scores.recall + 1 / scores.precision))


def matchings(rows: list[int], columns: list[int]) -> Iterator[list[tuple[int, int]]]:
    """All ways to pair some of the rows with one column each."""
    if not rows:
        yield []
        return
    yield from matchings(rows[1:], columns)
    for column in columns:
        for rest in matchings(rows[1:], [other for other in columns if other != column]):
            yield [(rows[0], column), *rest]


def hota_by_definition(estimate: People, truth: People) -> np.ndarray:
    """HOTA, DetA and AssA of Luiten et al. (2020), counted pair by pair; the matching of eq. 15 by trying all."""
    frames = list(frames_of(estimate, truth))
    n_found = {j: sum(j in found for found, _ in frames) for j in estimate}
    n_real = {i: sum(i in real for _, real in frames) for i in truth}
    similarity = [
        {(i, j): max(0.0, 1 - distance_m(a, b)) for i, a in real.items() for j, b in found.items()}
        for found, real in frames
    ]
    scores = []
    for alpha in np.arange(0.05, 0.99, 0.05):
        fits = [{pair for pair, value in each.items() if value >= alpha} for each in similarity]

        def association(pair: tuple[int, int], frames_with_pairs: list) -> float:
            together = sum(pair in pairs for pairs in frames_with_pairs)
            return together / (n_real[pair[0]] + n_found[pair[1]] - together)

        best = {pair: association(pair, fits) for pair in set().union(*fits)}
        matched = []
        for (found, real), pairs, values in zip(frames, fits, similarity, strict=True):
            candidates = [each for each in matchings(list(real), list(found)) if set(each) <= pairs]
            rank = [(len(c), round(sum(best[p] for p in c), 9), sum(values[p] for p in c)) for c in candidates]
            matched.append(set(candidates[rank.index(max(rank))]))
        tp = sum(map(len, matched))
        det_a = tp / (sum(n_found.values()) + sum(n_real.values()) - tp)
        ass_a = sum(association(pair, matched) for pairs in matched for pair in pairs) / tp if tp else 0.0
        scores.append([np.sqrt(det_a * ass_a), det_a, ass_a])
    return np.mean(scores, axis=0)


@pytest.mark.parametrize("seed", range(4))
def test_hota_agrees_with_its_definition(seed):
    estimate, truth = scene(seed, n_people=3, n_frames=40)
    expected = hota_by_definition(estimate, truth)
    assert (expected > 0.1).all()
    assert (expected < 0.9).all()
    scores = evaluate_people(estimate, truth)
    # the same counts; sums in another order
    np.testing.assert_allclose([scores.hota, scores.det_a, scores.ass_a], expected, rtol=1e-12)


def test_the_truth_itself_is_perfect():
    truth = people(standing(0), standing(3), only(standing(6), slice(4, None)))
    scores = evaluate_people(truth, truth)
    ones = ("recall", "precision", "f1", "mota", "idf1", "idp", "idr", "hota", "det_a", "ass_a", "pcp")
    assert [getattr(scores, name) for name in ones] == pytest.approx([1] * len(ones))
    zeros = ("switches", "fragmentations", "mpjpe_mm", "share_missing", "wrong_person", "n_frames_empty")
    assert [getattr(scores, name) for name in zeros] == [0] * len(zeros)
    assert (scores.n_frames, scores.n_people, scores.n_identities) == (10, 3, 3)
    assert [person.n_frames for person in scores.people] == [10, 10, 6]


def test_a_swap_of_two_people_in_the_middle():
    a_m, b_m = standing(0), standing(3)
    swapped = people(np.concatenate([a_m[:5], b_m[5:]]), np.concatenate([b_m[:5], a_m[5:]]))
    scores = evaluate_people(swapped, people(a_m, b_m))
    assert (scores.switches, scores.fragmentations, scores.recall, scores.mpjpe_mm) == (2, 0, 1.0, 0.0)
    assert scores.mota == pytest.approx(1 - 2 / 20)
    assert (scores.idf1, scores.idp, scores.idr) == (0.5, 0.5, 0.5)
    # each pair is together in 5 frames, its identities in 15 different ones
    assert (scores.det_a, scores.ass_a) == pytest.approx((1, 1 / 3))
    assert scores.hota == pytest.approx((1 / 3) ** 0.5)
    assert [person.switches for person in scores.people] == [1, 1]


@pytest.mark.parametrize(("offset_m", "n_alphas"), [(0.33, 13), (0.1, 18), (0.96, 0)])
def test_hota_of_somebody_who_is_off_by_a_constant(offset_m, n_alphas):
    """Similarity 0.67 reaches the alphas 0.05 to 0.65, 0.9 those to 0.9 (in floating point it is a little less)."""
    scores = evaluate_people(people(standing(1 + offset_m)), people(standing(1)))
    assert (scores.hota, scores.det_a, scores.ass_a) == pytest.approx((n_alphas / 19,) * 3)


def test_a_swap_of_two_people_who_stand_close():
    """The greater similarity decides between equal associations; CLEAR-MOT does not see the swap."""
    a_m, b_m = standing(0), standing(0.3)
    swapped = people(np.concatenate([a_m[:5], b_m[5:]]), np.concatenate([b_m[:5], a_m[5:]]))
    scores = evaluate_people(swapped, people(a_m, b_m))
    assert (scores.det_a, scores.ass_a) == pytest.approx((1, 1 / 3))
    assert (scores.switches, scores.recall) == (0, 1.0)
    assert scores.mpjpe_mm == pytest.approx(150)


def test_hota_of_half_the_frames():
    scores = evaluate_people(people(only(standing(0), slice(5))), people(standing(0)))
    assert (scores.hota, scores.det_a, scores.ass_a, scores.recall) == pytest.approx((0.5, 0.5, 0.5, 0.5))
    assert (scores.fragmentations, scores.n_frames_empty) == (0, 5)


def test_hota_prefers_more_pairs_to_a_better_association():
    """The case of TrackEval's issue 22: in the last of ten frames one estimate has similarity 0.49 to the person whom
    it followed and 0.51 to another."""
    followed_m = standing(0)
    followed_m[9, :, 0] = -0.51
    other_m = only(standing(0.49), [9])
    scores = evaluate_people(people(standing(0)), people(followed_m, other_m))
    # alpha up to 0.45: the person followed. 0.5: the other. Above: nobody
    assert scores.det_a == pytest.approx((10 * 10 / 11 + 9 * 9 / 12) / 19)
    assert scores.ass_a == pytest.approx((9 * 1 + (9 * 9 / 11 + 1 / 10) / 10 + 9 * 9 / 11) / 19)


def test_an_identity_is_kept_although_another_is_nearer():
    truth = people(standing(0))
    first_m, second_m = standing(0), only(standing(0), slice(5, None))
    first_m[5:, :, 0] = 0.4
    scores = evaluate_people(people(first_m, second_m), truth)
    assert (scores.switches, scores.recall, scores.precision) == (0, 1.0, 10 / 15)
    assert scores.mpjpe_mm == pytest.approx(200)
    first_m[5:, :, 0] = 0.6
    scores = evaluate_people(people(first_m, second_m), truth)
    assert (scores.switches, scores.fragmentations, scores.mpjpe_mm) == (1, 0, 0.0)


def test_a_switch_is_counted_after_a_gap_and_a_fragmentation_without_a_switch():
    truth = people(standing(0), only(standing(3), [0, 1, 2, 6, 7]))
    estimate = people(only(standing(0), [0, 1, 5, 6, 9]), only(standing(3), [0, 1, 2]), only(standing(3), [6, 7]))
    first, second = evaluate_people(estimate, truth).people
    assert (first.switches, first.fragmentations, first.recall) == (0, 2, 0.5)
    # away, not lost: no fragmentation
    assert (second.switches, second.fragmentations, second.recall, second.n_frames) == (1, 0, 1.0, 5)


def test_a_match_needs_a_distance_below_the_threshold():
    assert evaluate_people(people(standing(0.5)), people(standing(0))).recall == 0
    assert evaluate_people(people(standing(0.5)), people(standing(0)), match_m=0.51).recall == 1


def test_two_far_matches_are_preferred_to_one_near_match():
    """The first estimate is where the first person is, but the only one near the second."""
    scores = evaluate_people(people(standing(0), standing(0.45)), people(standing(0), standing(-0.45)))
    assert scores.recall == 1.0
    assert scores.mpjpe_mm == pytest.approx(450)


def test_errors_and_limbs_of_matched_people():
    truth_m, estimate_m = standing(0), standing(0)
    estimate_m[:, 0, 0] += 0.1
    estimate_m[:5, 1, 1] += 0.4
    estimate_m[:, 3] = np.nan
    truth_m[8:, 2] = np.nan
    # missed in half of the frames: no errors, but limbs that are not correct
    far_m = standing(10)
    scores = evaluate_people(people(estimate_m, only(far_m, slice(5))), people(truth_m, far_m))
    # 0.1 m in 10 frames and 0.4 m in 5, of 28 joints of the first and 20 of the second
    assert scores.mpjpe_mm == pytest.approx(1000 * (10 * 0.1 + 5 * 0.4) / 48)
    assert scores.share_missing == 10 / (38 + 20)
    # hip to knee, 0.4 m: mean error 0.25 m, wrong, in 5 frames, 0.05 m in 5; neck to head: known in 8, never found
    assert [person.pcp for person in scores.people] == [5 / 18, 0.5]
    assert scores.pcp == 15 / 38
    assert scores.people[0].mpjpe_mm == pytest.approx(1000 * 3 / 28)


def test_a_limb_may_be_off_by_half_its_length():
    estimate_m = standing(0)
    # 0.2 m is half of the limb; one end has all of the error and the mean half of it
    estimate_m[:, 0, 0], estimate_m[5:, 1, 0] = 0.3, 0.09
    assert evaluate_people(people(estimate_m), people(standing(0))).pcp == 1.0
    estimate_m[5:, 1, 0] = 0.11
    assert evaluate_people(people(estimate_m), people(standing(0))).pcp == 0.75


def test_a_joint_on_another_person():
    a_m, b_m = standing(0), standing(0.6)
    estimate_m = standing(0)
    # 0.1 m from the other's hip; knee between the two, near nobody; neck nearer to the other, but near its own too
    estimate_m[:, 0, 0], estimate_m[:, 1, 0], estimate_m[:, 2, 0] = 0.5, 0.3, 0.19
    b_m[5:, 2, 0] = 0.3
    b_m[9, 0] = np.nan
    scores = evaluate_people(people(estimate_m, standing(0.6)), people(a_m, b_m))
    # of 80 joints of both, one of the second person cannot be judged
    assert scores.wrong_person == 9 / 79
    assert scores.recall == 1.0


def test_the_joints_of_nobody_matched_are_nobodys():
    scores = evaluate_people(people(standing(0.6)), people(standing(0), only(standing(0.6), [])))
    assert (scores.recall, scores.precision, scores.n_people, scores.n_identities) == (0.0, 0.0, 1, 1)
    assert np.isnan([scores.mpjpe_mm, scores.wrong_person, scores.share_missing]).all()
    assert scores.pcp == 0.0
    assert (scores.people[1].n_frames, np.isnan(scores.people[1].recall)) == (0, True)


def test_everybody_missed_and_nobody_there():
    missed = evaluate_people({}, people(standing(0)))
    assert (missed.recall, missed.mota, missed.hota, missed.idf1, missed.n_frames_empty) == (0.0, 0.0, 0.0, 0.0, 10)
    assert np.isnan(missed.precision)
    ghosts = evaluate_people(people(standing(0)), people(only(standing(0), [])))
    assert (ghosts.precision, ghosts.idp, ghosts.hota, ghosts.n_people) == (0.0, 0.0, 0.0, 0)
    assert np.isnan([ghosts.recall, ghosts.mota]).all()


def test_joints_go_by_name_and_the_order_of_the_people_does_not_count():
    other = Skeleton("other", ("head", "tail", "knee", "hip"), bones=(), root=(3,))
    a_m, b_m = standing(0)[:, [3, 0, 1, 0]].copy(), standing(0.4)[:, [3, 0, 1, 0]].copy()
    a_m[:, 1] += 5
    truth = people(standing(0), standing(0.4))
    scores = evaluate_people({7: make(b_m, skeleton=other), 3: make(a_m, skeleton=other)}, truth)
    assert (scores.mpjpe_mm, scores.share_missing, scores.pcp) == (0.0, 0.0, 1.0)
    assert scores == evaluate_people({3: make(a_m, skeleton=other), 7: make(b_m, skeleton=other)}, truth)


def entering() -> tuple[People, People]:
    """The second of two true people enters in frame 6, the estimate begins in frame 2 and goes on after the end."""
    time_s = np.arange(15) / FPS
    truth = {1: make(standing(0)), 2: make(standing(3, 4), time_s[6:10])}
    return {5: make(standing(0, 13), time_s[2:] + 0.004), 6: make(standing(3, 9), time_s[6:])}, truth


def test_all_frames_of_the_truth_count_and_no_others():
    estimate, truth = entering()
    scores = evaluate_people(estimate, truth)
    assert (scores.n_frames, scores.n_frames_empty) == (10, 2)
    assert (scores.recall, scores.precision, scores.mpjpe_mm) == (12 / 14, 1.0, 0.0)


def test_the_frames_that_count_may_be_given():
    estimate, truth = entering()
    scores = evaluate_people(estimate, truth, time_s=np.arange(15) / FPS)
    assert (scores.n_frames, scores.recall, scores.precision) == (15, 12 / 14, 12 / 22)
    slow = evaluate_people(estimate, truth, time_s=np.arange(0, 15, 3) / FPS)
    # frames 0, 3, 6, 9 and 12
    assert (slow.n_frames, slow.recall, slow.precision) == (5, 5 / 6, 5 / 7)


def test_a_clock_of_its_own_is_set_by_an_offset():
    estimate, truth = entering()
    late = {identity: make(each.positions_m, each.time_s + 100) for identity, each in truth.items()}
    with pytest.raises(ValueError, match=r"the estimate lasts from 0\.044 to 0\.284 s, .* are from 100 to 100\.18 s"):
        evaluate_people(estimate, late)
    scores, expected = evaluate_people(estimate, late, truth_offset_s=-100.0), evaluate_people(estimate, truth)
    # Times of stays are rounded by the offset.
    assert replace(scores, stays=()) == replace(expected, stays=())
    assert [stay.begin_s for stay in scores.stays] == pytest.approx([stay.begin_s for stay in expected.stays])


def test_times_that_differ_by_rounding_are_one_frame():
    truth = {1: make(standing(0)), 2: make(standing(3), np.arange(10) / FPS + 1e-9)}
    scores = evaluate_people(truth, truth)
    assert (scores.n_frames, scores.recall) == (10, 1.0)


def test_revised_numbers_are_followed_to_the_end():
    """Called 1, then 5, who was called 3, and is 2; of a time at which there are several the last number counts."""
    frames = {2: [0, 1, 9], 3: [2, 3], 5: [4, 5], 1: [5, 6]}
    published = {number: make(only(standing(float(number)), own)) for number, own in frames.items()}
    renamed = {1: 5, 5: 3, 3: 2}
    events = [TrackEvent(0.0, before, "recognised", "", after) for before, after in renamed.items()]
    people_now = revised(published | {8: make(standing(8))}, [*events, TrackEvent(0.0, 8, "lost", "")])
    assert people_now.keys() == {2, 8}
    np.testing.assert_array_equal(np.round(people_now[2].time_s * FPS), [0, 1, 2, 3, 4, 5, 6, 9])
    np.testing.assert_allclose(people_now[2].positions_m[:, 0, 0], [2, 2, 3, 3, 5, 5, 1, 2])


def test_bad_input_is_refused():
    truth, tail = people(standing(0)), Skeleton("tail", ("tail",), bones=(), root=(0,))
    with pytest.raises(ValueError, match="the truth has no trajectory"):
        evaluate_people(truth, {})
    with pytest.raises(ValueError, match="no joint in common"):
        evaluate_people({1: make(np.zeros((10, 1, 3)), skeleton=tail)}, truth)
    with pytest.raises(ValueError, match="the people of the estimate must have one skeleton, got four, tail"):
        evaluate_people(truth | {2: make(np.zeros((10, 1, 3)), skeleton=tail)}, truth)
    for match_m in (0.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="match_m must be positive and finite"):
            evaluate_people(truth, truth, match_m=match_m)
    with pytest.raises(ValueError, match="time_s must increase"):
        evaluate_people(truth, truth, time_s=np.array([0.0, 0.02, 0.02]))
    with pytest.raises(ValueError, match=r"the truth lasts .* are from 8 to 9 s"):
        evaluate_people({}, truth, time_s=np.array([8.0, 9.0]))
