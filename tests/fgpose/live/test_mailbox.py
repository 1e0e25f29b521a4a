from __future__ import annotations

import threading

import pytest

from fgpose.live.cameras.mailbox import Mailbox
from fgpose.live.clock import Clock, SimulatedClock


def test_the_newest_wins() -> None:
    mailbox = Mailbox[int]()
    assert mailbox.take() is None
    for letter in range(5):
        mailbox.put(letter)
    assert mailbox.peek() == 4
    assert mailbox.take() == 4
    assert mailbox.take() is None


def test_mailboxes_that_share_a_condition_are_waited_for_together() -> None:
    changed = threading.Condition()
    mailboxes = [Mailbox[int](changed), Mailbox[int](changed)]
    thread = threading.Thread(target=lambda: mailboxes[1].put(7))
    with changed:
        thread.start()
        assert changed.wait_for(lambda: any(mailbox.peek() for mailbox in mailboxes), timeout=30)
    thread.join()
    assert mailboxes[1].take() == 7


def test_it_can_be_waited_for_until_somebody_has_taken_the_letter() -> None:
    mailbox = Mailbox[int]()
    assert mailbox.wait_until_empty(0.0)
    mailbox.put(1)
    assert not mailbox.wait_until_empty(0.0)
    thread = threading.Thread(target=mailbox.take)
    thread.start()
    assert mailbox.wait_until_empty(30.0)
    thread.join()


def test_a_simulated_clock_goes_only_where_it_is_told() -> None:
    clock = SimulatedClock(5.0)
    clock.advance(1.5)
    clock.sleep(2.0)
    clock.sleep(-1.0)
    assert clock.now_s() == 8.5
    with pytest.raises(ValueError, match="does not go back"):
        clock.advance(-0.1)


def test_the_real_clock_gives_unix_time_that_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.time", lambda: 1.7e9)
    clock = Clock()
    first_s = clock.now_s()
    monkeypatch.setattr("time.time", lambda: 0.0)  # somebody sets the computer's clock
    assert first_s == pytest.approx(1.7e9, abs=60)  # as long as this test may take on a busy computer
    assert clock.now_s() >= first_s
