"""Keypoints: read from the formats of 2D and monocular 3D pose estimators, and whole recordings in our own."""

from fgpose.io.keypoints.keypoint_files import keypoint_cameras as keypoint_cameras
from fgpose.io.keypoints.keypoint_files import load_observations as load_observations
from fgpose.io.keypoints.keypoint_files import load_people as load_people
from fgpose.io.keypoints.keypoint_files import load_recording as load_recording
from fgpose.io.keypoints.people_files import save_people_observations as save_people_observations
from fgpose.io.keypoints.recording_files import save_observations as save_observations
from fgpose.io.keypoints.uncalibrated import check_sizes as check_sizes
from fgpose.io.keypoints.uncalibrated import likely_sizes_px as likely_sizes_px
from fgpose.io.keypoints.uncalibrated import load_uncalibrated as load_uncalibrated
