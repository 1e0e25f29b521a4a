"""The normal equations in numpy against the GTSAM graph of the same segment: cost, step, covariance, solution."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import gtsam
import numpy as np
import pytest

import fgpose
from fgpose.config import Config, DepthConfig, MotionConfig, ProjectionConfig, SolverConfig, SymmetryConfig
from fgpose.estimation.evidence.evidence import Evidence
from fgpose.estimation.evidence.gather import gather
from fgpose.estimation.factors.bone_length import SharedLengths
from fgpose.estimation.factors.joint_rows import JointRows
from fgpose.estimation.factors.kinds import factors_of, graph_factors
from fgpose.estimation.factors.state import BatchState, Information
from fgpose.estimation.initial_guess import fill_gaps, median_lengths
from fgpose.estimation.keys import position_key
from fgpose.estimation.segment import Segment
from fgpose.estimation.solvers.gtsam_batch import GtsamBatch
from fgpose.estimation.solvers.levenberg_marquardt import levenberg_marquardt
from fgpose.estimation.solvers.normal_equations import NormalEquations
from fgpose.geometry.camera import CameraRig
from fgpose.skeleton import BoneLengths, Skeleton
from fgpose_benchmarks.synthetic import Scene

N_FRAMES = 9
CONFIGS = {
    "default": Config(),
    "random_walk": Config(motion=MotionConfig(model="random_walk")),
    "no_motion": Config(motion=MotionConfig(model="none")),
    "symmetry_of_each_frame": Config(symmetry=SymmetryConfig(form="frame")),
    "no_symmetry": Config(symmetry=SymmetryConfig(form="none")),
    "paper_like": Config(
        motion=MotionConfig(model="none"),
        symmetry=SymmetryConfig(form="frame"),
        projection=ProjectionConfig(kernel="none", weighting="uniform"),
    ),
    "depth_of_every_view": Config(depth=DepthConfig(use="always", correlation_s=0.1)),
    "depth_of_no_view": Config(depth=DepthConfig(use="never")),
    "huber": Config(projection=ProjectionConfig(kernel="huber"), depth=DepthConfig(use="always", kernel="huber")),
    "geman_mcclure": Config(projection=ProjectionConfig(kernel="geman_mcclure", kernel_scale=4.0)),
    "tukey": Config(projection=ProjectionConfig(kernel="tukey", kernel_scale=6.0)),
}
# The steps are compared for every one of them.
SOME_CONFIGS = [
    name if name in ("default", "paper_like") else pytest.param(name, marks=pytest.mark.slow) for name in CONFIGS
]


def comes_and_goes(skeleton: Skeleton) -> np.ndarray:
    """One joint enters late, one leaves early, one is away for two frames, one is never there; frame 6 has nobody."""
    active = np.ones((N_FRAMES, skeleton.n_joints), dtype=bool)
    active[:2, skeleton.index("head")] = False
    active[5:, skeleton.index("left_ankle")] = False
    active[2:4, skeleton.index("right_wrist")] = False
    active[:, skeleton.index("spine")] = False
    active[4, 6:14] = False
    active[6] = False
    return active


def difficult(scene: Scene, rig: CameraRig, config: Config) -> tuple[Evidence, np.ndarray]:
    """Joints that come and go, some unseen, some anchored, one whose depth is needed, detections missing and wild,
    uneven time steps."""
    skeleton, seen = scene.observations.skeleton, scene.observations.frames(slice(0, N_FRAMES))
    points2d_px = seen.points2d_px.copy()
    points2d_px[4:6, :2, skeleton.index("right_ankle")] = np.nan
    evidence = gather(dataclasses.replace(seen, points2d_px=points2d_px), rig, config)
    rng = np.random.default_rng(0)
    undistorted_px = evidence.undistorted_px.copy()
    undistorted_px[rng.random(undistorted_px.shape[:3]) < 0.2] = np.nan
    undistorted_px[2, 1, 4] += 300.0
    n_views = np.isfinite(undistorted_px).all(axis=-1).sum(axis=1)
    for joint in ("left_elbow", "left_wrist", "right_knee"):
        undistorted_px[3:6, :, skeleton.index(joint)] = np.nan
        n_views[3:6, skeleton.index(joint)] = 0
    anchored = np.zeros(n_views.shape, dtype=bool)
    anchored[1:4, 2] = True
    time_s = evidence.time_s + np.linspace(0, 0.3, N_FRAMES) ** 2
    evidence = dataclasses.replace(
        evidence,
        time_s=time_s,
        undistorted_px=undistorted_px,
        n_views=n_views,
        anchored=anchored,
        guess_m=fill_gaps(evidence.guess_m, time_s) + rng.normal(scale=0.02, size=evidence.guess_m.shape),
    )
    return evidence, comes_and_goes(skeleton)


def difficult_segment(scene: Scene, rig: CameraRig, config: Config, **changes: Any) -> Segment:
    skeleton = scene.observations.skeleton
    evidence, active = difficult(scene, rig, config)
    active = changes.pop("active", active)
    evidence = dataclasses.replace(evidence, **changes)
    lengths_m = median_lengths(skeleton, evidence.guess_m)
    lengths_m[2] = np.nan
    density = np.random.default_rng(1).uniform(0.3, 30.0, size=active.shape)
    return Segment(rig, skeleton, config, evidence, active, lengths_m, density)


def in_linkages(scene: Scene, rig: CameraRig, config: Config) -> Segment:
    """The difficult segment of a body whose arms and legs nothing joins to the trunk; the spine, which is in no frame,
    is a linkage of its own as far as small ones are not put together."""
    segment = difficult_segment(scene, rig, config)
    body = segment.skeleton
    limbs = {joint for pair in body.limb_pairs for bone in pair for joint in bone}
    bones = [bone for bone in body.bones if len(limbs & set(bone)) != 1]
    apart = Skeleton("apart", body.joints, bones, body.root, body.left_right, body.limbs)
    assert len(apart.linkages) > 1
    number = {frozenset(bone): length for bone, length in zip(body.bones, body.length_of_bone, strict=True)}
    lengths_m = np.full(apart.n_lengths, np.nan)
    for bone, length in zip(bones, apart.length_of_bone, strict=True):
        lengths_m[length] = segment.lengths_m[number[frozenset(bone)]]
    return dataclasses.replace(segment, skeleton=apart, lengths_m=lengths_m)


def both(scene: Scene, rig: CameraRig, config: Config, **changes: Any) -> tuple[NormalEquations, GtsamBatch]:
    segment = difficult_segment(scene, rig, config, **changes)
    return NormalEquations(segment), GtsamBatch(segment)


def gauss_newton_step(problem: NormalEquations | GtsamBatch, state: Any, damping: float) -> np.ndarray:
    system = problem.factorized(state, damping)
    assert system is not None
    return -system.solve(problem.gradient(state))


@pytest.fixture
def without_tension(monkeypatch: pytest.MonkeyPatch) -> None:
    """The curvature of bones under tension makes better steps to the same optimum; GTSAM does not have it."""
    monkeypatch.setattr(SharedLengths, "add_tension", lambda *_: None)


def check_two_steps(ours: NormalEquations, theirs: GtsamBatch, damping: float = 0.0) -> None:
    """Same error, and same step, at the first guess and after it; that shows gradient and information to be the same.

    Tolerances: both lose about six digits to the condition of the information matrix.
    """
    state, values = ours.initial(), theirs.initial()
    for _ in range(2):
        assert ours.error(state) == pytest.approx(theirs.error(values), rel=1e-9)
        step, step_of_graph = gauss_newton_step(ours, state, damping), gauss_newton_step(theirs, values, damping)
        assert ours.step_size(step) == pytest.approx(theirs.step_size(step_of_graph), abs=1e-10)
        state, values = ours.moved(state, step), theirs.moved(values, step_of_graph)
        np.testing.assert_allclose(ours.positions_m(state), theirs.positions_m(values), rtol=0, atol=1e-10)
        np.testing.assert_allclose(ours.lengths_m(state), theirs.lengths_m(values), rtol=0, atol=1e-10)


def test_every_config_changes_the_problem(walking_scene, rig):
    """A setting that both solvers ignore would pass all comparisons."""
    errors = {}
    for name, config in CONFIGS.items():
        problem = NormalEquations(difficult_segment(walking_scene, rig, config))
        errors[name] = problem.error(problem.initial())
    same = [pair for pair in itertools.combinations(errors, 2) if errors[pair[0]] == pytest.approx(errors[pair[1]])]
    assert same == []


@pytest.mark.parametrize("name", CONFIGS)
@pytest.mark.usefixtures("without_tension")
def test_steps_are_those_of_the_graph(walking_scene, rig, name):
    check_two_steps(*both(walking_scene, rig, CONFIGS[name]))


@pytest.mark.parametrize("name", ["default", "symmetry_of_each_frame", "random_walk"])
@pytest.mark.usefixtures("without_tension")
def test_steps_of_several_linkages_are_those_of_the_graph(walking_scene, rig, name):
    """Arms, legs and the rest, which only lengths have to do with each other; symmetry of each frame joins both arms
    and both legs."""
    segment = in_linkages(walking_scene, rig, CONFIGS[name])
    check_two_steps(NormalEquations(segment), GtsamBatch(segment))


@pytest.mark.usefixtures("without_tension")
def test_damped_steps_are_those_of_the_graph(walking_scene, rig):
    check_two_steps(*both(walking_scene, rig, Config()), damping=1e3)


@pytest.mark.usefixtures("without_tension")
def test_known_lengths_are_those_of_the_graph(walking_scene, rig):
    segment = difficult_segment(walking_scene, rig, Config())
    sigma_m = np.linspace(0.01, 0.03, len(segment.lengths_m))
    known = BoneLengths(segment.lengths_m, sigma_m)
    segment = dataclasses.replace(segment, lengths_known=True, known=known)
    check_two_steps(NormalEquations(segment), GtsamBatch(segment))


@pytest.mark.usefixtures("without_tension")
def test_correlated_lengths_are_those_of_the_graph(walking_scene, rig):
    """Who has long legs has long arms."""
    segment = difficult_segment(walking_scene, rig, Config())
    lengths_m = segment.lengths_m * np.linspace(0.9, 1.2, len(segment.lengths_m))
    lengths_m[::3] = np.nan
    known = BoneLengths(lengths_m, np.where(np.isnan(lengths_m), np.inf, 0.02))
    segment = dataclasses.replace(segment, known=known)
    check_two_steps(NormalEquations(segment), GtsamBatch(segment))


@pytest.mark.usefixtures("without_tension")
def test_held_joints_are_those_of_the_graph(walking_scene, rig):
    """A hand where the body says it is; one that is held in a frame in which it is not estimated is not."""
    segment = difficult_segment(walking_scene, rig, Config())
    rng = np.random.default_rng(3)
    axes = rng.normal(size=(N_FRAMES, 3, 3))
    joint = segment.skeleton.index("left_wrist")
    at_m = segment.evidence.guess_m[:, joint] + rng.normal(scale=0.05, size=(N_FRAMES, 3))
    at_m[2] = np.nan
    evidence = segment.evidence.held(joint, at_m, 1e-4 * (axes @ axes.swapaxes(-1, -2)))
    held = dataclasses.replace(segment, evidence=evidence)
    check_two_steps(NormalEquations(held), GtsamBatch(held))
    problem, without = NormalEquations(held), NormalEquations(segment)
    assert problem.error(problem.initial()) > without.error(without.initial()) + 100


def shared_lengths(segment: Segment) -> SharedLengths:
    return next(factors for factors in factors_of(segment) if isinstance(factors, SharedLengths))


def no_information(state: BatchState) -> Information:
    n_frames, n_kinds, n_slots, _ = state.joints.shape
    frames = np.zeros((n_frames, *2 * (n_slots, 3, n_kinds)))
    return Information([np.arange(n_slots)], [frames], len(state.lengths_m))


def test_tension_is_the_curvature_that_gauss_newton_leaves_out(walking_scene, rig):
    """Of bones that are too long, against second differences of their cost."""
    segment = difficult_segment(walking_scene, rig, Config())
    bones = shared_lengths(segment)
    state = NormalEquations(segment).initial()
    short = BatchState(state.joints, np.full_like(state.lengths_m, 0.05))
    row = int(np.flatnonzero(bones.present[0])[0])
    start, end = bones.slots[:, row]
    single = dataclasses.replace(
        bones,
        slots=bones.slots[:, [row]],
        present=bones.present[:, [row]] & (np.arange(N_FRAMES)[:, None] == 0),
        sigma_m=bones.sigma_m[[row]],
        length_of_row=bones.length_of_row[[row]],
    )
    information = no_information(state)
    single.add_information(information, short)
    single.add_tension(information, short)
    information.spread()

    def cost(shift_m: np.ndarray) -> float:
        joints = short.joints.copy()
        joints[0, 0, [start, end]] += shift_m.reshape(2, 3)
        return single.error(BatchState(joints, short.lengths_m))

    h, units = 1e-5, np.eye(6)
    hessian = np.array(
        [[cost(h * (a + b)) - cost(h * (a - b)) - cost(h * (b - a)) + cost(-h * (a + b)) for b in units] for a in units]
    ) / (4 * h**2)
    of_positions = information.frames[0][0, :, :, 0, :, :, 0]
    expected = of_positions[np.ix_([start, end], range(3), [start, end], range(3))].reshape(6, 6)
    # cost of about 1e3 by 4 h^2 of 4e-10 leaves 1e-3 of entries of 4e4
    np.testing.assert_allclose(expected, hessian, atol=1e-3 * np.abs(expected).max())
    at_length = no_information(state)
    single.add_tension(at_length, BatchState(state.joints, np.full_like(state.lengths_m, 2.0)))
    at_length.spread()
    assert not at_length.frames[0].any(), "a bone that is too short has no tension"


def test_two_joints_at_one_point_have_no_tension(walking_scene, rig):
    """Their bone has no direction, even where the estimate of its length has become negative (seen in a soak)."""
    segment = difficult_segment(walking_scene, rig, Config())
    bones = shared_lengths(segment)
    state = NormalEquations(segment).initial()
    at_one_point = BatchState(np.zeros_like(state.joints), np.full_like(state.lengths_m, -0.1))
    information = no_information(state)
    with np.errstate(all="raise"):
        bones.add_tension(information, at_one_point)
    information.spread()
    assert not information.frames[0].any()


@pytest.mark.parametrize("name", ["default", "symmetry_of_each_frame"])
def test_the_remainder_is_what_the_linearisation_of_the_bones_leaves_out(walking_scene, rig, name):
    """Along a random direction, against differences of the residuals alone."""
    segment = difficult_segment(walking_scene, rig, CONFIGS[name])
    problem = NormalEquations(segment)
    state = problem.initial()
    (rows,) = (factors for factors in factors_of(segment) if isinstance(factors, JointRows))
    rng = np.random.default_rng(4)
    step, direction = (0.05 * rng.normal(size=problem.damping_scale.size) for _ in range(2))

    def residual(share: float, along: np.ndarray) -> np.ndarray:
        return rows.whitened(problem.moved(state, share * along))[0]

    h = 1e-5
    linear = (residual(h, step) - residual(-h, step)) / (2 * h)
    left_out = residual(1.0, step) - residual(0.0, step) - linear
    slope = (residual(h, direction) - residual(-h, direction)) / (2 * h)
    # second differences leave 1e-10 of the residuals, of which the remainder is a hundredth
    assert np.dot(direction, problem.remainder(state, step)) == pytest.approx(np.sum(slope * left_out), rel=1e-6)
    assert np.abs(left_out).max() > 1.0, "bones that bend by a sigma"


class Counting(NormalEquations):
    factorisations = 0

    def factorized(self, state: BatchState, damping: float) -> Any:
        self.factorisations += 1
        return super().factorized(state, damping)


class Uncorrected(Counting):
    def remainder(self, state: BatchState, step: np.ndarray) -> np.ndarray:
        return np.zeros_like(step)


@pytest.mark.slow
def test_corrected_steps_need_fewer_factorisations(walking_scene, rig):
    """From a start that is 20 cm off in each coordinate."""
    segment = difficult_segment(walking_scene, rig, Config())
    problems = Counting(segment), Uncorrected(segment)
    for problem in problems:
        start = problem.initial()
        start.joints[:, 0] += 0.2 * np.random.default_rng(2).normal(size=start.joints[:, 0].shape)
        assert levenberg_marquardt(problem, start, 100).convergence.converged
    corrected, uncorrected = (problem.factorisations for problem in problems)
    assert corrected < 0.75 * uncorrected, (corrected, uncorrected)


@pytest.mark.parametrize("name", SOME_CONFIGS)
def test_the_batch_of_gtsam_is_the_graph_of_all_factors(walking_scene, rig, name):
    segment = difficult_segment(walking_scene, rig, CONFIGS[name])
    batch, graph = GtsamBatch(segment), whole_graph(segment)
    values = batch.initial()
    assert batch.error(values) == pytest.approx(graph.error(values), rel=1e-12)
    ordering = gtsam.Ordering(values.keys())
    linear, expected = batch.gaussian(values), graph.linearize(values)
    assert linear.size() == expected.size()
    for ours, theirs in zip(linear.hessian(ordering), expected.hessian(ordering), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12 * np.abs(theirs).max())


@pytest.mark.usefixtures("without_tension")
def test_a_joint_behind_a_camera_neither_pulls_nor_fails(walking_scene, rig):
    evidence, _ = difficult(walking_scene, rig, Config())
    guess_m = evidence.guess_m.copy()
    camera = rig.cameras[0]
    guess_m[2, 5] = camera.position_m - 0.5 * camera.world_T_camera[:3, 2]
    check_two_steps(*both(walking_scene, rig, Config(), guess_m=guess_m))


@pytest.mark.parametrize("form", ["frame", "shared_length"])
@pytest.mark.usefixtures("without_tension")
def test_a_bone_of_length_zero(walking_scene, rig, skeleton, form):
    evidence, _ = difficult(walking_scene, rig, Config())
    guess_m = evidence.guess_m.copy()
    guess_m[1, skeleton.index("left_knee")] = guess_m[1, skeleton.index("left_hip")]
    config = Config(symmetry=SymmetryConfig(form=form))
    check_two_steps(*both(walking_scene, rig, config, guess_m=guess_m))


@pytest.mark.usefixtures("without_tension")
def test_one_frame(walking_scene, rig, skeleton):
    evidence = gather(walking_scene.observations.frames(slice(0, 1)), rig, Config())
    lengths_m = median_lengths(skeleton, evidence.guess_m)
    segment = Segment(rig, skeleton, Config(), evidence, np.ones((1, 17), dtype=bool), lengths_m, np.ones((1, 17)))
    check_two_steps(NormalEquations(segment), GtsamBatch(segment))


def whole_graph(segment: Segment) -> gtsam.NonlinearFactorGraph:
    """With the shared lengths as callback factors, which the batch keeps beside its graph."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in graph_factors(segment):
        graph.add(factor)
    return graph


@pytest.mark.parametrize("name", SOME_CONFIGS)
def test_covariance_equals_gtsams_marginals(walking_scene, rig, skeleton, name):
    config = CONFIGS[name]
    segment = difficult_segment(walking_scene, rig, config)
    ours = NormalEquations(segment)
    covariance_m2 = ours.linearized(ours.positions_m(ours.initial())).covariance_m2()
    marginals = gtsam.Marginals(whole_graph(segment), GtsamBatch(segment).initial())
    active = comes_and_goes(skeleton)
    for frame, joint in np.ndindex(active.shape):
        if active[frame, joint]:
            expected_m2 = marginals.marginalCovariance(position_key(joint, frame))
            # relative to the largest entry: both lose about six digits to the condition of the information matrix
            atol = 1e-9 * np.abs(expected_m2).max()
            np.testing.assert_allclose(covariance_m2[frame, joint], expected_m2, rtol=0, atol=atol)
        else:
            assert np.isnan(covariance_m2[frame, joint]).all()


def test_two_exact_views_at_right_angles_have_the_covariance_of_the_textbook(walking_scene, rig, skeleton):
    """A point at the centre of the ring: each view measures two directions, to depth x sigma / focal length."""
    centre_m = np.zeros((1, skeleton.n_joints, 3))
    centre_m[..., 2] = 1.0
    pair = rig.subset(rig.names[:2])
    sigma_px = float(np.exp(1.1))  # its logarithm is a multiple of a thousandth, so it is not rounded
    motion, projection = MotionConfig(model="none"), ProjectionConfig(kernel="none")
    config = Config(projection=projection, motion=motion, symmetry=SymmetryConfig(form="none"))
    active = np.zeros((1, skeleton.n_joints), dtype=bool)
    active[0, 0] = True
    evidence = Evidence(
        time_s=np.zeros(1),
        undistorted_px=pair.project(centre_m[0])[None],
        bias_px=np.zeros((1, 2, 17, 2)),
        bias_share=np.ones((1, 17)),
        bias_m2=np.zeros((1, 17, 3, 3)),
        confidence=np.ones((1, 2, 17)),
        weights=np.ones((1, 2, 17)),
        sigma_px=np.full((1, 2, 17), sigma_px),
        visibility=np.ones((1, 2, 17)),
        credible=np.ones((1, 17)),
        n_views=np.full((1, 17), 2),
        fused_m=centre_m,
        guess_m=centre_m,
        off_path_m=np.full((1, 17, 3), np.nan),
        anchored=np.zeros((1, 17), dtype=bool),
        views_m=np.zeros((1, 0, 17, 3)),
        rays=np.zeros((1, 0, 17, 3)),
        depth_sigma_m=np.zeros((1, 0, 17)),
        from_bones=np.zeros((1, 17), dtype=bool),
        delay_s=np.zeros((1, 2)),
        sides_exchanged=np.zeros((1, 2, 17), dtype=bool),
        implausible=np.zeros(1, dtype=bool),
        held_m=np.full((1, 17, 3), np.nan),
        held_information=np.zeros((1, 17, 3, 3)),
    )
    ours = NormalEquations(
        Segment(pair, skeleton, config, evidence, active, np.full(skeleton.n_lengths, np.nan), np.ones((1, 17)))
    )
    of_detections = np.zeros((3, 3))
    for camera in pair.cameras:
        R, depth_m = camera.camera_T_world[:3, :3], camera.to_camera_frame(centre_m[0, 0])[2]
        sideways = R[:2]
        of_detections += sideways.T @ sideways * (camera.K[0, 0] / depth_m / sigma_px) ** 2
    information = of_detections + np.eye(3) / config.prior.position_sigma_m**2
    covariance_m2 = ours.linearized(centre_m).covariance_m2()[0, 0]
    np.testing.assert_allclose(covariance_m2, np.linalg.inv(information), rtol=1e-9, atol=1e-18)


@pytest.mark.slow
def test_the_solution_is_that_of_gtsam_on_a_real_recording():
    """Both go on until hardly anything moves. Process noise and weights are fixed, for they follow from steps that
    differ between the two."""
    rig, observations = fgpose.files.load_recording(fgpose.files.recordings()[0])
    observations = observations.frames(slice(0, 30))
    solved = {}
    for backend in ("numpy", "gtsam"):
        solver = SolverConfig(backend=backend, step_tolerance_m=1e-6, max_iterations=200)
        config = Config(solver=solver, motion={"adaptive": False}, visibility={"model": "none"})
        solved[backend] = fgpose.smooth(observations, rig, config)
    apart_m = np.linalg.norm(solved["numpy"].positions_m - solved["gtsam"].positions_m, axis=-1)
    assert solved["numpy"].convergence is not None
    assert solved["numpy"].convergence.converged
    # Both end when no joint moves by more than 1 um; where they converge slowly, the rest of the way is longer.
    assert 0 < np.nanmax(apart_m) < 2e-5, "two solvers, which never agree to the last digit"
