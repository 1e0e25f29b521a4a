"""Online estimation, frame by frame, in a window of fixed lag."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from fgpose.config import Config
from fgpose.estimation.evidence.image_checks.checks import ImageChecks
from fgpose.estimation.evidence.image_checks.left_out import left_out_px, showing_left_out
from fgpose.estimation.evidence.inputs import check_known
from fgpose.estimation.evidence.plausibility import without_clipped
from fgpose.estimation.online.arrivals import Turns, check_frame, check_later, one_frame, one_image
from fgpose.estimation.online.clock_jumps import SET_BACK, Ahead, SetBack
from fgpose.estimation.online.clock_offsets import RunningOffsets
from fgpose.estimation.online.clock_steps import ClockSteps
from fgpose.estimation.online.exclusive import Exclusive, exclusive
from fgpose.estimation.online.one_moment import OneMoment
from fgpose.estimation.parts.online import HungPart, of_whole_body
from fgpose.estimation.parts.part_estimator import PartEstimator
from fgpose.estimation.parts.whole import of_part
from fgpose.geometry.camera import CameraRig
from fgpose.geometry.changing_rig import refuse_changing, warn_far_apart
from fgpose.io.skeletons import as_skeleton
from fgpose.observations import Observations
from fgpose.shown import Shown
from fgpose.skeleton import BoneLengths, Skeleton
from fgpose.trajectory import Estimate


class Estimator(Shown, Exclusive):
    """The pose of one person, live: each update takes the newest frame and returns the pose at its time, which is the
    mean time at which the cameras took it: time stamps, and the mean time offset of the rig.

    The window holds online.lag_s, and is solved by online.solver. Bone lengths are learned as it runs (RunningLengths)
    and are held in the graph, so that no Python callback is left in iSAM2. With online.estimate_time_offsets it also
    learns how late each camera is (rig_with_offsets); with estimators of other people in the room, where they share the
    offsets.

    Hands and face (Skeleton.parts) are estimated by themselves, where they hang on the body.

    After frames in which nobody is detected for 0.5 s, who comes may be somebody else: bone lengths are learned anew,
    unless is_one_person. Where somebody takes the place of another at once, the bones of the former are used for one to
    two seconds more, until Estimate.other_bone says so; covariances are too small meanwhile.

    A frame that is more than a minute later than all before is refused until the next one is later still: its stamp may
    be wrong. After ten that are more than a minute older the clock was set back: with a warning, all begins anew but
    bone lengths and time offsets. A recording whose times are known to be right, and which pauses for more than a
    minute, is taken with times_are_checked.

    With online.solver "window" it can be pickled and copied, to be continued elsewhere. With "isam2" it cannot: GTSAM's
    smoother has no serialisation. Start a new one and feed it the last few seconds again; it settles within a second.

    Several threads may use it, as those of the callbacks of several cameras: one waits for the other.
    """

    def __init__(
        self,
        rig: CameraRig,
        skeleton: Skeleton | str,
        config: Config | None = None,
        offsets: RunningOffsets | None = None,
        *,
        times_are_checked: bool = False,
        is_one_person: bool = False,
    ) -> None:
        super().__init__()
        check_known("Estimator", rig, skeleton)
        refuse_changing(rig)
        warn_far_apart(rig)
        skeleton = as_skeleton(skeleton)
        self.rig, self.skeleton, self.config = rig, skeleton, config or Config()
        body = skeleton.of_joints(skeleton.body) if skeleton.parts else skeleton
        self._body = PartEstimator(rig, body, self.config, offsets, is_one_person=is_one_person)
        self._is_one_person = is_one_person
        self._turns, self._one_moment = Turns(), OneMoment(rig.names)
        self._ahead, self._set_back = (None, None) if times_are_checked else (Ahead(rig.names), SetBack())
        self._steps = None if times_are_checked else ClockSteps(rig.names)
        self._checks = ImageChecks.none(rig.n_cameras, skeleton)
        self._left_out_px = np.full((rig.n_cameras, skeleton.n_joints, 2), np.nan)  # of the newest frame
        self._parts = [HungPart(part, skeleton, rig, self.config, self._body.offsets) for part in skeleton.parts]

    def __getstate__(self) -> dict[str, object]:
        if self.config.online.solver == "isam2":
            raise TypeError(
                "this Estimator cannot be saved: GTSAM's iSAM2 has no serialisation. Choose online.solver = "
                '"window", or start a new one and feed it the last few seconds again.'
            )
        return super().__getstate__()

    @property
    @exclusive
    def rig_with_offsets(self) -> CameraRig:
        """The rig with the time offsets learned so far; as it was given unless online.estimate_time_offsets."""
        return self._body.rig_with_offsets

    @property
    @exclusive
    def newest(self) -> Estimate | None:
        """The pose of the newest frame, as the last update gave it; None: there was none."""
        of_body = self._body.newest
        if of_body is None:
            return None
        if self._parts:
            of_body = of_whole_body(self.skeleton, of_body, [each.newest for each in self._parts])
        return showing_left_out(of_body, self._left_out_px, self.rig)

    @property
    def n_implausible(self) -> int:
        """In how many frames what was detected makes no body; those are left out, see Estimate.is_implausible."""
        return self._body.n_implausible

    @property
    def repairs(self) -> int:
        """How often GTSAM failed and the window was eliminated anew; updates are slower for a while after that."""
        return self._body.repairs + sum(each.estimator.repairs for each in self._parts)

    @exclusive
    def know(self, lengths: BoneLengths) -> None:
        """Expect the bones of somebody who is known: Trajectory.bones or Estimate.bone_lengths of before, or measured.
        Until they have left or were not detected for 0.5 s, for who comes then may be somebody else; or until it is
        seen that they are somebody else's (Estimate.other_bone). Raises ValueError: they are not those of the skeleton.
        """
        lengths.check(self.skeleton)
        for estimator in (self._body, *(each.estimator for each in self._parts)):
            estimator.know(of_part(lengths, self.skeleton, estimator.skeleton))

    @exclusive
    def update(self, frame: Observations) -> Estimate:
        """Take the newest frame: any subset of the rig's cameras, any of the joints, even none.

        Detections that make no body are left out, as if nobody had been detected (Estimate.is_implausible); so are
        those that repeat the image before to the last digit, views that go over to somebody else, and images that were
        taken far from most of the frame, by the times of the cameras (OneMoment). The image of one camera alone (the
        others have no time, or are not in the frame) is taken as update_camera takes it, as are those of cameras that
        show somebody in turns: it may join the frame before, whose pose is returned then.

        Raises:
            ValueError: there is more than one frame, a camera is not in the rig, the skeleton differs, or time does
                not increase (TooLateError: a repeated or older frame) or is more than a minute after all before and
                not confirmed by the next frame yet; or none of the first frames makes a body: the calibration is in
                millimetres. The estimator is then as it was before.

        Warns:
            UserWarning: images of a camera are left out, as they were taken far from the others; or the clock was set
                back.
        """
        check_frame(frame, self.skeleton)
        seen = frame.with_cameras(self.rig.names)
        taken_s = np.broadcast_to(seen.time_s, (1, self.rig.n_cameras))[0]
        if frame.n_cameras < self.rig.n_cameras:
            taken_s = np.where(np.isin(self.rig.names, frame.camera_names), taken_s, np.nan)
        seen, taken_s = self._one_moment.of(seen, taken_s, self._body.usual_step_s)
        if self._is_set_back(float(seen.frame_time_s[0])):
            return self._begun_anew(lambda anew: anew.update(frame))
        check_later(seen, self._body.newest_s)
        shows = seen.seen[0].any(axis=1)
        taken_s = self._turns.taken_s(shows, taken_s)
        estimate = self._take(seen, taken_s)
        self._turns.add(shows)
        return estimate

    def update_arrays(
        self,
        time_s: float | Float[np.ndarray, " camera"],
        points2d_px: Float[np.ndarray, "camera joint 2"],
        confidence: float | Float[np.ndarray, "camera joint"] = 1.0,
        points3d_m: Float[np.ndarray, "camera joint 3"] | None = None,
        covariance3d_m2: Float[np.ndarray, "camera joint 3 3"] | None = None,
    ) -> Estimate:
        """Take the newest frame as arrays, the cameras in the order of the rig; see Observations.

        Args:
            time_s: of the frame, or of each camera's image (NaN: none).
            points2d_px: pixels of the original images; NaN where a joint was not detected.
            confidence: in [0, 1].
            points3d_m: absolute 3D joints as each view alone gives them, in the world frame.
            covariance3d_m2: of points3d_m.

        Raises:
            ValueError: as update and Observations.
        """
        arrays = points2d_px, confidence, points3d_m, covariance3d_m2
        return self.update(one_frame(self.skeleton, time_s, self.rig.names, arrays))

    @exclusive
    def update_camera(
        self,
        camera: str,
        time_s: float,
        points2d_px: Float[np.ndarray, "joint 2"],
        confidence: float | Float[np.ndarray, " joint"] = 1.0,
        points3d_m: Float[np.ndarray, "joint 3"] | None = None,
        covariance3d_m2: Float[np.ndarray, "joint 3 3"] | None = None,
    ) -> Estimate:
        """Take one image of one camera as it comes, at its own time; arguments as update_arrays.

        It begins a new frame or joins one that is there (see Arrivals), its detections moved to the time of that frame.
        A joint of a frame is predicted until a second camera sees it. Images of a camera whose clock was set, and most
        others were not, are left out until it is right again (ClockSteps).

        Returns:
            The pose at the time of the newest frame, which need not be that of the image.

        Raises:
            ValueError: the camera is not in the rig, its image was there before, no frame of the window can take it
                (TooLateError), it is a minute or more after all others and no other camera has an image of that time
                yet, or the arrays are not as they should be. The estimator is then as it was before.

        Warns:
            UserWarning: the clock of a camera was set, and its images are left out (ClockSteps); or that of all was set
                back.
        """
        if camera not in self.rig.names:
            raise ValueError(f"the rig has no camera {camera!r}; it has {', '.join(self.rig.names)}")
        arrays = points2d_px, confidence, points3d_m, covariance3d_m2
        image = one_image(self.skeleton, time_s, camera, arrays).with_cameras(self.rig.names)
        if self._is_set_back(float(image.frame_time_s[0])):
            return self._begun_anew(lambda anew: anew.update_camera(camera, time_s, *arrays))
        return self._take(image, np.where(np.array(self.rig.names) == camera, time_s, np.nan))

    @exclusive
    def tidy(self) -> None:
        """Do what the next update would do first: learn from the newest frame and from what has left the window, and
        revise the frames in between. To be called in the time until the next images come, which are estimated sooner
        then. Images that join the newest frame afterwards are not learned from."""
        self._body.tidy()
        for each in self._parts:
            each.estimator.tidy()

    def _is_set_back(self, time_s: float) -> bool:
        return self._set_back is not None and self._set_back.is_seen(time_s, self._body.newest_s)

    def _begun_anew(self, take: Callable[[Estimator], Estimate]) -> Estimate:
        """After the clock was set back. Raises what the new estimator does; this one is then as it was before."""
        before = self.newest
        assert before is not None
        known = self.rig, self.skeleton, self.config, self._body.offsets
        anew = Estimator(*known, is_one_person=self._is_one_person)
        if before.bone_lengths is not None:
            anew.know(before.bone_lengths)
        estimate = take(anew)
        warnings.warn(SET_BACK.format(by_s=before.time_s - estimate.time_s), UserWarning, stacklevel=4)
        vars(self).update({**vars(anew), "_lock": self._lock})
        return estimate

    def _take(self, images: Observations, taken_s: Float[np.ndarray, " camera"]) -> Estimate:
        """Images of all cameras. Raises ValueError as update and update_camera."""
        if self._ahead is not None:
            self._ahead.check(taken_s, self._body.newest_s)
        steps = None if self._steps is None else self._steps.plus(taken_s)
        if steps is not None and (left_out := steps.left_out & np.isfinite(taken_s)).any():
            images = images.without(np.broadcast_to(left_out[None, :, None], images.confidence.shape))
            taken_s = np.where(left_out, np.nan, taken_s)
        before = self.newest if np.isnan(taken_s).all() else None
        estimate = self._use(images, taken_s) if before is None else before
        if steps is not None:
            self._steps, self._body.offsets.set_by_s = steps, steps.lasting_s
            steps.warn()
        return estimate

    def _use(self, images: Observations, taken_s: Float[np.ndarray, " camera"]) -> Estimate:
        """Those that are of their time."""
        before_s = self._body.newest_s
        of_person, checks = self._checks.checked(images, self._body.expected_m, self.rig)
        estimate = self._estimate(of_person, taken_s)
        self._checks = checks
        of_newest = (self._body.newest_s > before_s) | (taken_s == self._body.newest_images_s)
        left_out = left_out_px(images, without_clipped(of_person, self.rig))[0]
        self._left_out_px = np.where(of_newest[:, None, None], left_out, self._left_out_px)
        return showing_left_out(estimate, self._left_out_px, self.rig)

    def _estimate(self, images: Observations, taken_s: Float[np.ndarray, " camera"]) -> Estimate:
        if not self._parts:
            return self._body.take(images, taken_s)
        of_body = self._body.take(images.of_joints(self._body.skeleton, self.skeleton.body), taken_s)
        of_parts = [each.take(images, taken_s, of_body) for each in self._parts]
        return of_whole_body(self.skeleton, of_body, of_parts)
