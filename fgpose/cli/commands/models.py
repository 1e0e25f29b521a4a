"""What comes with fgpose, or can be fetched: weights of pose networks, and skeletons."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from rich.table import Table
from tyro.conf import Positional, arg, subcommand

from fgpose.cli.console import new_console, new_table, print_written
from fgpose.io.atomic import write_text
from fgpose.io.skeletons import builtin_skeletons, load_skeleton

_NAMES = "blazepose-lite, blazepose-full or blazepose-heavy."


@dataclass(frozen=True, kw_only=True)
class Pull:
    """Fetch a model into the cache, or check that it is there. Needs the network once.

    The weights come out of the package that ships them (with pip; blazepose-lite and -heavy also need npm), are
    converted to ONNX and checked. The cache is ~/.cache/fgpose; FGPOSE_CACHE names another folder.

    Example: fgpose models pull blazepose-full
    """

    name: Annotated[Positional[str], arg(metavar="NAME", help=_NAMES)]

    def run(self) -> None:
        from fgpose.monocular.downloads.models import find_model

        model = find_model(self.name)
        with new_console(stderr=True).status(f"checking {model.name}") as status:
            pulled = model.pull(status.update)
        console = new_console()
        for path in (pulled.landmarks, pulled.detector):
            console.print(str(path), soft_wrap=True)
        console.print(f"{model.licence}: {pulled.landmarks.with_name('LICENSE')}", soft_wrap=True)


@dataclass(frozen=True, kw_only=True)
class ListModels:
    """List the models that can be fetched, which of them are in the cache, and on which devices networks can run here.

    Example: fgpose models list
    """

    def run(self) -> None:
        from fgpose.extensions import added
        from fgpose.monocular.downloads.models import MODELS
        from fgpose.monocular.networks.devices import available_devices, chosen_device

        console = new_console()
        for model in MODELS:
            pulled = model.in_cache()
            where = pulled.landmarks if pulled else "not pulled"
            size = f"{model.n_bytes / 1e6:.1f} MB"
            line = f"{model.name:<16} {model.licence:<11} {size:>8}  {model.skeleton:<13} {where}"
            console.print(line, soft_wrap=True)
        for name in added("fgpose.detectors"):
            console.print(f"{name:<16} of another package", soft_wrap=True)
        try:
            devices = f"{', '.join(available_devices())}; auto takes {chosen_device('auto')}"
        except ImportError:
            devices = "none without onnxruntime (pip install 'fgpose[video]')"
        console.print(f"--device: {devices}", soft_wrap=True)


@dataclass(frozen=True, kw_only=True)
class Models:
    """Fetch weights of pose networks, or list them.

    pull fetches those of a network, list lists what there is, which is the default.

    Example: fgpose models pull blazepose-full
    """

    action: (
        Annotated[Pull, subcommand("pull", prefix_name=False)]
        | Annotated[ListModels, subcommand("list", prefix_name=False)]
    ) = field(default_factory=ListModels)

    def run(self) -> None:
        self.action.run()


@dataclass(frozen=True, kw_only=True)
class Skeletons:
    """List the skeletons that fgpose knows, or show one.

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
        from fgpose.io.made_by import check_result
        from fgpose.viewer.skeleton_picture import skeleton_picture

        skeleton, console = load_skeleton(name), new_console()
        if self.picture is not None:
            if self.picture.suffix.lower() != ".svg":
                raise ValueError(f"{self.picture}: a picture of a skeleton is written as .svg")
            check_result(self.picture, "skeletons", remedy="choose another with --picture, or remove it")
            write_text(self.picture, skeleton_picture(skeleton))
        root = " and ".join(skeleton.joints[joint] for joint in skeleton.root)
        console.print(
            f"{skeleton.name}: {skeleton.n_joints} joints, root {root}; of each joint those that bones join it to"
        )
        listed = Table.grid(padding=(0, 2))
        listed.add_column(justify="right")
        listed.add_column(no_wrap=True)
        for number, joint in enumerate(skeleton.joints):
            ends = [other for bone in skeleton.bones if number in bone for other in bone if other != number]
            listed.add_row(str(number), joint, ", ".join(skeleton.joints[end] for end in ends))
        console.print(listed)
        if self.picture is not None:
            print_written(console, self.picture)
