"""Several people in one room: who is who in the images of all cameras, and the motion of each.

What one learns: what an image of several people is (fgpose.people.Detections), smooth_people, what happened to each
track, and how people who were told apart are measured against true ones.

    python examples/10_several_people.py --output docs/people.png
"""

from __future__ import annotations

from pathlib import Path

import tyro

import fgpose
from fgpose_benchmarks.comparison.plot_style import BLUE, VERMILLION, make_plain, new_figure
from fgpose_benchmarks.synthetic import (
    CrowdErrors,
    CrowdScene,
    DetectionNoise,
    Occlusion,
    crowd_motion,
    embedded_motion,
    ring_rig,
    simulate_crowd,
)

COLOURS = (BLUE, VERMILLION, "#009E73", "#CC79A7", "#E69F00", "#56B4E9")


def film(n_people: int, n_cameras: int, duration_s: float) -> CrowdScene:
    """People who walk and work in one room; people hide each other, and detectors miss, double and mix them up."""
    walks, works = [embedded_motion("cmu_02_01_short")], [embedded_motion("cmu_02_07_a"), embedded_motion("cmu_02_10")]
    motion = crowd_motion(n_people, int(50 * duration_s), 50.0, walks, works, seed=1)
    rig = ring_rig(n_cameras, 5.0, 2.7, (0.0, 0.0, 0.9), focal_px=850.0, size_px=(1600, 1200))
    return simulate_crowd(motion, rig, DetectionNoise(), Occlusion(), CrowdErrors(), seed=1)


def main(people: int = 3, cameras: int = 4, duration_s: float = 8.0, output: Path = Path("out/people.png")) -> None:
    """Film people, tell them apart, smooth each, and draw their ways from above.

    Args:
        people: in the room.
        cameras: around it.
        duration_s: of the recording.
        output: where the figure goes.
    """
    scene = film(people, cameras, duration_s)
    smoothed = fgpose.smooth_people(scene.observations, scene.rig)
    for person, trajectory in smoothed.trajectories.items():
        print(f"person {person}: {trajectory.time_s[0]:.1f} to {trajectory.time_s[-1]:.1f} s")
    for event in smoothed.association.events:
        print(f"{event.time_s:6.2f} s  person {event.person} {event.what}: {event.reason}")
    print(f"{smoothed.association.n_unused} detections belong to nobody")

    time_s = smoothed.association.frames.frame_time_s
    truth = scene.truth(time_s)
    score = fgpose.people.evaluate_people(smoothed.trajectories, truth, time_s=time_s)
    print(f"recall {score.recall:.1%}, precision {score.precision:.1%}, IDF1 {score.idf1:.1%}, HOTA {score.hota:.1%}")
    print(f"{score.switches} identity switches, mean error {score.mpjpe_mm:.1f} mm")

    figure = new_figure(4.8, 6.4, "Ways of the hips from above")
    axes = figure.subplots()
    for true in truth.values():
        axes.plot(*true.positions_m[:, 0, :2].T, color="0.8", linewidth=5)
    for person, (trajectory, colour) in enumerate(zip(smoothed.trajectories.values(), COLOURS * people, strict=False)):
        axes.plot(*trajectory.positions_m[:, 0, :2].T, color=colour, linewidth=1.5, label=f"person {person}")
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    figure.legend(loc="outside right upper", fontsize=9, frameon=False, title="grey: true")
    make_plain(axes, "", "both")
    output.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(output, dpi=150)
    print(f"wrote {output}")


if __name__ == "__main__":
    tyro.cli(main)
