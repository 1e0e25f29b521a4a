"""The skeletons that come with fgpose."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from fgpose.cli.console import new_console, new_table, print_written
from fgpose.io.atomic import check_replaceable, write_text
from fgpose.io.skeletons import builtin_skeletons, load_skeleton


@dataclass(frozen=True, kw_only=True)
class Skeletons:
    """List the skeletons that come with fgpose, or show the joints and bones of one.

    Names are also found as other programs write them: BODY_25, halpe26, COCO.

    Example: fgpose skeletons; then fgpose skeletons halpe_26 --picture halpe.svg
    """

    skeleton: Annotated[Positional[str | None], arg(metavar="NAME|FILE", help_behavior_hint="(default: list all)")] = (
        None
    )
    """A built-in skeleton, or your own TOML file of the same form."""
    picture: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Draw it into an SVG file, which browsers show."""

    def run(self) -> None:
        if self.skeleton is not None:
            self._show(self.skeleton)
        elif self.picture is not None:
            raise ValueError("--picture is of one skeleton: name it")
        else:
            table = new_table("skeleton", "joints", "bone lengths", "begins with")
            for skeleton in map(load_skeleton, builtin_skeletons()):
                first = ", ".join(skeleton.joints[:2])
                table.add_row(skeleton.name, str(skeleton.n_joints), str(skeleton.n_lengths), first)
            new_console().print(table)

    def _show(self, name: str) -> None:
        from fgpose.viewer.skeleton_picture import skeleton_picture

        skeleton, console = load_skeleton(name), new_console()
        if self.picture is not None:
            check_replaceable(self.picture)
            write_text(self.picture, skeleton_picture(skeleton))
        root = " and ".join(skeleton.joints[joint] for joint in skeleton.root)
        console.print(
            f"{skeleton.name}: {skeleton.n_joints} joints, root {root}; of each joint those that bones join it to"
        )
        for number, joint in enumerate(skeleton.joints):
            ends = [other for bone in skeleton.bones if number in bone for other in bone if other != number]
            console.print(f"{number:3}  {joint:<18} {', '.join(skeleton.joints[end] for end in ends)}".rstrip())
        if self.picture is not None:
            print_written(console, self.picture)
