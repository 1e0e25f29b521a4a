"""One sender for each camera: another one under its name is refused, and said."""

from __future__ import annotations

import pytest

from fgpose.live.reception.rejections import MessageError
from fgpose.live.reception.senders import Senders


@pytest.fixture
def contested() -> list[str]:
    return []


@pytest.fixture
def senders(contested: list[str]) -> Senders:
    return Senders("camera", contested.append)


def test_a_second_sender_is_refused_until_the_first_falls_silent(senders: Senders, contested: list[str]) -> None:
    senders.take("a", 1, 0.0)
    with pytest.raises(MessageError, match="camera a: a second sender; both are doubtful"):
        senders.take("a", 2, 0.9)
    assert contested == ["a"]
    senders.take("b", 2, 0.9)  # of another camera it is the first
    senders.take("a", 2, 1.1)  # as a detector that has connected again
    with pytest.raises(MessageError):
        senders.take("a", 1, 1.2)
    assert contested == ["a", "a"]


def test_where_connections_are_not_known_there_is_one_sender(senders: Senders, contested: list[str]) -> None:
    for k in range(100):
        senders.check_heard(None, 0.01 * k)
        senders.take("a", None, 0.01 * k)
    assert contested == []


def contest(senders: Senders, camera: str, now_s: float) -> None:
    senders.check_heard(2, now_s)
    with pytest.raises(MessageError):
        senders.take(camera, 2, now_s)


def test_who_is_refused_again_and_again_is_not_read_for_a_while(senders: Senders) -> None:
    senders.take("a", 1, 0.0)
    for k in range(20):
        contest(senders, "a", 0.001 * k)
    with pytest.raises(MessageError, match="too many messages"):
        senders.check_heard(2, 0.5)
    senders.check_heard(1, 0.5)  # others are
    senders.check_heard(2, 1.5)


def test_a_sender_of_another_camera_is_heard_all_the_same(senders: Senders, contested: list[str]) -> None:
    senders.take("a", 1, 0.0)
    for k in range(100):
        senders.take("b", 2, 0.001 * k)
        contest(senders, "a", 0.001 * k)
    assert contested == ["a"] * 100  # each was read
