"""Successions of revolutes in a URDF, which knows no other turning joints, as joints of two and three axes."""

from __future__ import annotations

import itertools
from collections.abc import Collection
from dataclasses import replace

from jointest_ros.core.robot import Joint
from jointest_ros.core.rotation import dot

_PARALLEL = 0.99  # cosine: two such axes are no joint of two


def merged(
    joints: list[Joint],
    bare: Collection[str],
    bearing: Collection[str],
    folded: dict[str, list[str]],
    notes: list[str],
) -> tuple[list[Joint], set[str]]:
    """The joints, successions through links that are nothing but frames as one, and those links, which are gone.

    The joint positions keep their names.

    Args:
        bare, bearing, folded: links without anything on them, with an IMU, and with others that are fixed to them.
        notes: gets a line where the names of the positions do not tell of what joint they are.
    """
    gone: set[str] = set()
    result: list[Joint] = []
    for joint in joints:
        if joint.parent in gone:
            continue
        chain = [joint]
        while len(chain) < 3:
            link = chain[-1].child
            after = [other for other in joints if other.parent == link]
            frame = link in bare and link not in bearing and link not in folded
            if len(after) != 1 or not frame or any(after[0].origin) or after[0].continuous != joint.continuous:
                break
            if abs(dot(chain[-1].axes[0], after[0].axes[0])) > _PARALLEL:
                break
            chain.append(after[0])
        if len(chain) == 1:
            result.append(joint)
            continue
        names, frames = tuple(one.name for one in chain), [one.child for one in chain[:-1]]
        axes = tuple(one.axes[0] for one in chain)
        name = _common(names, [one.name for one in joints if one not in chain])
        whole = Joint(name, joint.parent, chain[-1].child, axes, _limits(chain), joint.continuous, joint.origin)
        if whole.coordinates != names:
            whole = replace(whole, names=names)
            notes.append(
                f"{', '.join(names)}: one joint '{name}' of {len(axes)} axes, since nothing but a frame without an IMU "
                f"is between them ({', '.join(frames)})"
            )
        result.append(whole)
        gone |= set(frames)
    return result, gone


def _common(names: tuple[str, ...], taken: Collection[str]) -> str:
    """The words that all names begin with: hip for hip_flexion, hip_abduction."""
    together = zip(*(name.split("_") for name in names), strict=False)
    common = "_".join(words[0] for words in itertools.takewhile(lambda words: len(set(words)) == 1, together))
    return common if common and common not in taken else "_".join(names)


def _limits(chain: list[Joint]) -> tuple[tuple[float, float], ...] | None:
    pairs = [one.limits[0] for one in chain if one.limits is not None]
    return tuple(pairs) if len(pairs) == len(chain) else None
