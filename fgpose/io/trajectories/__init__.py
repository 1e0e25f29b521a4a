"""Result files of one person or several: written and read whatever the format; joint angles of the motion."""

from fgpose.io.trajectories.loading import READABLE as READABLE
from fgpose.io.trajectories.loading import load_origin as load_origin
from fgpose.io.trajectories.loading import load_people_trajectories as load_people_trajectories
from fgpose.io.trajectories.loading import load_trajectory as load_trajectory
from fgpose.io.trajectories.loading import load_upright as load_upright
from fgpose.io.trajectories.saving import EXTENSIONS as EXTENSIONS
from fgpose.io.trajectories.saving import check_output as check_output
from fgpose.io.trajectories.saving import people_paths as people_paths
from fgpose.io.trajectories.saving import save_people as save_people
from fgpose.io.trajectories.saving import save_trajectory as save_trajectory
