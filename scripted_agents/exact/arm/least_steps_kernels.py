"""Compiled kernels of the exact minimum number of steps of an arm with any number of joints.

`nearest_pose` computes the least distance from tip to target over all poses with every joint within
`width` of its current angle. If the tip cannot touch the target, the nearest pose is a local
minimum of the distance h > 0. Each of its joints is either at an end of its range or free. Free
joints lie on the line through tip and target, as turning one must not change the distance to first
order. They cut the arm after the first of them into rigid pieces of end-to-end lengths L_i, which
all lie along that line, with signs s_i. To second order, with x_i = s_i L_i along the line from
target to tip, the matrix x x' - h diag(x) must have no negative eigenvalue. So there are two cases,
with q the vector from the first free joint to the target. Either all pieces point at the target,
and it is out of reach (h = |q| - sum L). Or one piece points at it, all others point back, and it
is longer than these together with |q| (h = L_p - sum of the others - |q|). `nearest_pose` searches
these at most 3**joints closed forms as a tree, and prunes branches with a free joint out of its
range. (Pieces of length 0 turn freely, to a bound.)

This is valid only while the tip cannot touch the target, so `march` widens the range by steps too
small for that. Turning joints by less than x moves link k by less than k x, and the tip by less
than the sum over k of 2 sin(k x / 2).
"""

from __future__ import annotations

from math import atan2, ceil, cos, floor, inf, nan, pi, sin, sqrt
from typing import Any, NamedTuple

import numpy as np

from pursuit.compilation.compiled import allocating, inlined, subroutine

ROUNDING = 1e-9
"""Angles and distances with a smaller difference count as equal, and prove nothing."""
SHORT = 1e-6
"""A shorter piece has no direction; its joint counts as within its range."""
LOW, HIGH, FREE = 0, 1, 2
"""The choices for a joint: the lower or upper end of its range, or free."""
STRETCHED, ENDS_ONLY = -1, -2
"""Kinds of poses; other kinds are the number of the piece that points at a target too near."""


class Search(NamedTuple):
    """Scratch memory of the search, each [n + 2]: the state before every joint, and the best pose.

    A piece is rigid, from one free joint to the next or to the tip. `pieces` counts the finished
    pieces and the current one, and `first` is the joint where the current one starts.
    """

    turns: Any  # complex, the current angles as unit numbers
    last: Any  # [1] complex, the last link with all links that do not turn, along the x-axis
    tail: Any  # [1] float64, its length
    place: Any  # complex, the position of the joint, from the base or from the start of its piece
    heading: Any  # complex, direction of the previous link, in the same frame
    out: Any  # complex, the same for the previous piece, from the line between its ends
    pieces: Any  # int64
    first: Any  # int64
    gap: Any  # float64, from the first free joint to the target
    total: Any  # float64, the lengths of the finished pieces
    longest: Any  # float64, the longest of them
    which: Any  # int64, its number
    stretched: Any  # bool, whether all of them can point at the target
    back: Any  # bool, whether all of them can point back
    forth: Any  # int64, bit i: whether piece i can point at the target, and the others back
    choice: Any  # int64, LOW, HIGH or FREE
    best: Any  # int64, the choices of the nearest pose, then its kind
    spare: Any  # float64, a candidate pose
    visits: Any  # [1] int64, nodes of the tree visited so far


@allocating
def least_steps_kernel(
    angles: Any, targets: Any, tolerances: Any, free_joints: Any, max_turn: float, budget: int,
    steps: Any, goals: Any,
) -> None:  # fmt: skip
    """Fill `steps` [games, 2] with lower and upper bounds, `goals` [games, n] with turns.

    Only the first `free_joints` turn. A goal is NaN if the joints can have any angle."""
    n = angles.shape[1]
    numbers, lengths = np.empty((4, n + 2), np.complex128), np.empty((4, n + 2))
    whole, flags = np.empty((6, n + 2), np.int64), np.empty((2, n + 2), np.bool_)
    search = Search(
        numbers[0], np.empty(1, np.complex128), np.empty(1), numbers[1], numbers[2], numbers[3],
        whole[0], whole[1], lengths[0], lengths[1], lengths[2], whole[2], flags[0], flags[1],
        whole[3], whole[4], whole[5], lengths[3], np.empty(1, np.int64),
    )  # fmt: skip
    for game in range(angles.shape[0]):
        march(
            angles[game], targets[game], tolerances[game], free_joints[game], max_turn, budget,
            search, steps[game], goals[game],
        )  # fmt: skip


@subroutine
def march(
    angles: Any, target: Any, tolerance: float, n: int, max_turn: float, budget: int, search: Any,
    steps: Any, goal: Any,
) -> None:  # fmt: skip
    """One game: widen the range in increments that are too small for the tip to touch the target.

    Only the first n joints turn. After `budget` nodes the range is widened one step at a time: the
    upper bound stays valid, but the lower bound is no longer raised.
    """
    goal[:] = 0.0
    steps[:] = 0
    distance = distance_at(angles, goal, target)
    if distance <= tolerance:
        return
    prepare(angles, n, search)
    at = complex(target[0], target[1])
    enough = tolerance - ROUNDING
    last = ceil(pi / max_turn * (1.0 - ROUNDING))  # then every joint can have any angle
    # `proved` steps are too few; within `tried` steps no pose was found.
    width, proved, tried, safe = 0.0, 0, 0, True
    while tried < last:
        safe = safe and search.visits[0] <= budget
        if safe:
            width += safe_turn(n, search.tail[0], distance)
            count = min(floor(width / max_turn), last)
        else:
            count = tried + 1
        if count > tried:
            width = min(count * max_turn, pi)
        distance = nearest_pose(at, n, width, enough, search)
        if distance > enough:
            tried = max(tried, count)
            if safe and distance > tolerance:
                proved = tried
            continue
        pose_of(at, n, width, search, goal)
        if distance_at(angles, goal, target) > tolerance:
            # A result of rounding, from too short a piece: nothing is proved from here on.
            tried, safe = max(tried, count), False
            continue
        count = max(count, tried + 1)
        while count - tried > 1:  # all in the safe range
            middle = (tried + count) // 2
            distance = nearest_pose(at, n, middle * max_turn, enough, search)
            if distance > enough:
                tried = middle
                if distance > tolerance:
                    proved = middle
                continue
            search.spare[:] = 0.0
            pose_of(at, n, middle * max_turn, search, search.spare)
            if distance_at(angles, search.spare, target) <= tolerance:
                count = middle
                for joint in range(n):
                    goal[joint] = search.spare[joint]
            else:
                tried = middle  # as above
        steps[0], steps[1] = proved + 1, count
        return
    goal[:] = nan
    steps[0], steps[1] = min(proved + 1, last), last


@subroutine
def prepare(angles: Any, n: int, search: Any) -> None:
    """Store the angles as unit numbers, and the locked links after joint n - 1 as one link."""
    for joint in range(n):
        search.turns[joint] = complex(cos(angles[joint]), sin(angles[joint]))
    last, heading = complex(1.0, 0.0), complex(1.0, 0.0)
    for joint in range(n, angles.shape[0]):
        heading *= complex(cos(angles[joint]), sin(angles[joint]))
        last += heading
    search.last[0], search.tail[0] = last, size(last)
    search.visits[0] = 0


@subroutine
def safe_turn(n: int, tail: float, distance: float) -> float:
    """A turn x of all joints that moves the tip by slightly less than `distance` > 0."""
    low, high = 0.0, pi
    for _ in range(12):
        x = 0.5 * (low + high)
        moved = 2.0 * tail * sin(0.5 * min(n * x, pi))
        for link in range(1, n):
            moved += 2.0 * sin(0.5 * min(link * x, pi))
        if moved < distance - ROUNDING:
            low = x
        else:
            high = x
    return max(low, (distance - ROUNDING) / (n * (n + 1 + 2 * tail)))


@subroutine
def distance_at(angles: Any, turned: Any, target: Any) -> float:
    """The distance from tip to target if the joints are turned by `turned`."""
    x, y, direction = 0.0, 0.0, 0.0
    for joint in range(angles.shape[0]):
        direction += angles[joint] + turned[joint]
        x += cos(direction)
        y += sin(direction)
    return sqrt((x - target[0]) ** 2 + (y - target[1]) ** 2)


@subroutine
def nearest_pose(target: complex, n: int, width: float, enough: float, s: Any) -> float:
    """The least distance to the target within `width` < pi of the current angle of every joint.

    The result is valid if it is above 0. The search stops at the first distance that is at most
    `enough`. The pose is stored in `best`.
    """
    low, high = complex(cos(width), -sin(width)), complex(cos(width), sin(width))
    # The largest squared change of the unit number of a free joint.
    span = (2.0 * sin(0.5 * width) + ROUNDING) ** 2
    nearest = inf
    s.place[0], s.heading[0] = 0.0, 1.0
    s.pieces[0] = 0
    s.choice[0] = -1
    joint = 0
    while joint >= 0:
        s.choice[joint] += 1
        if joint == n:
            kind, distance = pose_at_the_end(target, n, span, s)
            if distance < nearest:
                nearest = distance
                for each in range(n):
                    s.best[each] = s.choice[each]
                s.best[n] = kind
                if distance <= enough:
                    break
            joint -= 1
        elif s.choice[joint] > FREE:
            joint -= 1
        else:
            s.visits[0] += 1
            after = joint + 1
            if s.choice[joint] == FREE:
                hopeful = free_joint(joint, target, n, span, s)
            else:
                turn = s.turns[joint] * (low if s.choice[joint] == LOW else high)
                carry(joint, s)
                s.heading[after] = s.heading[joint] * turn
                s.place[after] = s.place[joint] + link(joint, n, s.heading[after], s)
                hopeful = True
            if hopeful and may_be_nearer(after, target, n, nearest, s):
                s.choice[after] = -1
                joint = after
    return nearest


@subroutine
def carry(joint: int, s: Any) -> None:
    """Copy the state of the pieces before a joint to the state after it."""
    after = joint + 1
    s.out[after] = s.out[joint]
    s.pieces[after], s.first[after] = s.pieces[joint], s.first[joint]
    s.gap[after], s.total[after] = s.gap[joint], s.total[joint]
    s.longest[after], s.which[after] = s.longest[joint], s.which[joint]
    s.stretched[after], s.back[after] = s.stretched[joint], s.back[joint]
    s.forth[after] = s.forth[joint]


@subroutine
def free_joint(joint: int, target: complex, n: int, span: float, s: Any) -> bool:
    """End the piece at this joint and start one; whether the joints so far can be in range."""
    after = joint + 1
    if s.pieces[joint] == 0:
        carry(joint, s)
        to_target = target - s.place[joint]
        gap = size(to_target)
        s.gap[after], s.total[after], s.longest[after] = gap, 0.0, 0.0
        # As if a piece of length 0 pointed at the target before.
        s.out[after] = s.heading[joint] * to_target.conjugate() / gap if gap > 0.0 else 1.0
        s.stretched[after], s.back[after] = True, False
        s.forth[after] = 0
        possible = True
    else:
        possible = end_piece(joint, span, s)
    s.pieces[after] = s.pieces[joint] + 1
    s.first[after] = joint
    s.heading[after] = 1.0
    s.place[after] = link(joint, n, s.heading[after], s)
    return possible


@subroutine
def end_piece(joint: int, span: float, s: Any) -> bool:
    """Measure the piece that ends at `joint` into the state after it; whether signs remain."""
    after = joint + 1
    carry(joint, s)
    chord = s.place[joint]
    length = size(chord)
    number = s.pieces[joint] - 1
    if length < SHORT or (number == 0 and s.gap[joint] < SHORT):
        same = other = True
        s.out[after] = s.heading[joint]
        if length > 0.0:
            s.out[after] *= chord.conjugate() / length
    else:
        along = chord.conjugate() / length
        turn = along * s.out[joint].conjugate()  # of the free joint, if both pieces point alike
        same = squared(turn - s.turns[s.first[joint]]) <= span
        other = squared(turn + s.turns[s.first[joint]]) <= span
        s.out[after] = s.heading[joint] * along
    s.total[after] += length
    if length > s.longest[joint]:
        s.longest[after], s.which[after] = length, number
    forth = 0
    if number == 0:  # the piece of length 0 before it points at the target
        forth = 1 if same else 0
        s.back[after] = other
    else:
        latest = s.forth[joint] & (1 << (number - 1))
        if same:
            forth |= s.forth[joint] ^ latest
        if other:
            forth |= latest
            if s.back[joint]:
                forth |= 1 << number
        s.back[after] = s.back[joint] and same
    s.forth[after] = forth
    s.stretched[after] = s.stretched[joint] and same
    return s.stretched[after] or s.back[after] or forth != 0


@subroutine
def may_be_nearer(joint: int, target: complex, n: int, nearest: float, s: Any) -> bool:
    """Whether the joints from this one on could lead to a pose nearer than `nearest`."""
    if s.pieces[joint] == 0:
        return joint == n or size(target - s.place[joint]) - left_from(joint, n, s) < nearest
    left = left_from(s.first[joint], n, s)  # bounds the current piece and all after it
    total, gap = s.total[joint], s.gap[joint]
    if s.stretched[joint] and gap - total - left < nearest:
        return True
    if (s.back[joint] or s.pieces[joint] == 1) and left >= total + gap:
        return True
    return s.forth[joint] != 0 and 2.0 * s.longest[joint] >= total + gap


@subroutine
def pose_at_the_end(target: complex, n: int, span: float, s: Any) -> Any:
    """The kind and the distance of the pose with these choices; inf if there is none."""
    if s.pieces[n] == 0:
        return ENDS_ONLY, size(target - s.place[n])
    if not end_piece(n, span, s):
        return ENDS_ONLY, inf
    total, longest, gap = s.total[n + 1], s.longest[n + 1], s.gap[n + 1]
    if s.stretched[n + 1] and gap >= total:
        return STRETCHED, gap - total
    which = s.which[n + 1]
    if s.forth[n + 1] & (1 << which) and 2.0 * longest - total >= gap:
        return which, 2.0 * longest - total - gap
    return ENDS_ONLY, inf


@subroutine
def pose_of(target: complex, n: int, width: float, s: Any, turned: Any) -> None:
    """Fill `turned` [n] with the turns to the pose in `search.best`."""
    kind = s.best[n]
    place, heading, out = complex(0.0, 0.0), complex(1.0, 0.0), complex(1.0, 0.0)
    number, first = -1, 0
    for joint in range(n + 1):
        choice = s.best[joint] if joint < n else FREE
        if choice != FREE:
            turned[joint] = -width if choice == LOW else width
            heading *= s.turns[joint] * complex(cos(width), sin(turned[joint]))
            place += link(joint, n, heading, s)
            continue
        if number < 0:
            ahead = target - place
            out = heading * ahead.conjugate()
        else:
            alike = kind == STRETCHED or (number != kind and number - 1 != kind)
            if number == 0:
                alike = kind == STRETCHED or kind == 0
            # From the current angle to the angle at which its piece lies along the line.
            away = place.conjugate() * out.conjugate() * s.turns[first].conjugate()
            if not alike:
                away = -away
            turned[first] = min(max(atan2(away.imag, away.real), -width), width)
            out = heading * place.conjugate()
        number += 1
        first = joint
        heading = complex(1.0, 0.0)
        if joint < n:
            place = link(joint, n, heading, s)


@inlined
def link(joint: int, n: int, heading: complex, s: Any) -> complex:
    """The vector from this joint to the next, or to the tip."""
    return heading * s.last[0] if joint == n - 1 else heading


@inlined
def left_from(joint: int, n: int, s: Any) -> float:
    """The length of the links from this joint on."""
    return n - 1 - joint + s.tail[0]


@subroutine
def size(number: complex) -> float:
    """The absolute value (without the protection of `abs` against overflow)."""
    return sqrt(number.real * number.real + number.imag * number.imag)


@subroutine
def squared(number: complex) -> float:
    """The square of the absolute value."""
    return number.real * number.real + number.imag * number.imag
