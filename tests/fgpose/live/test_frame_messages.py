"""A frame survives the way through a message; what is no frame is refused."""

from __future__ import annotations

from dataclasses import replace

import pytest
from live_frames import live_judgement

from fgpose.io.live.packing import packed, unpacked
from fgpose.io.skeletons import load_skeleton
from fgpose.live.frame import LiveJudgement
from fgpose.live.outputs.frame_messages import decode_frame, encode_frame, frame_document
from tests.fgpose.live.output_frames import SKELETON, assert_same_frame, frame


@pytest.mark.parametrize("people", [(), (3,), (4, 7)])
def test_a_message_says_what_the_frame_says(people: tuple[int, ...]) -> None:
    assert_same_frame(decode_frame(encode_frame(frame(8, people)), SKELETON), frame(8, people))


def test_a_frame_before_the_first_image_can_be_sent() -> None:
    got = decode_frame(encode_frame(replace(frame(0, ()), time_s=float("nan"))), SKELETON)
    assert got.time_s != got.time_s


@pytest.mark.parametrize("said", [live_judgement(), LiveJudgement(waits_for="nobody was seen to move yet"), None])
def test_what_the_diagnosis_says_is_in_the_message(said: LiveJudgement | None) -> None:
    got = decode_frame(encode_frame(replace(frame(1), diagnosis=said)), SKELETON)
    assert got.diagnosis == said


def test_an_older_message_says_nothing_of_a_diagnosis() -> None:
    document = unpacked(encode_frame(frame(1)))
    del document["diagnosis"]
    assert decode_frame(packed(document), SKELETON).diagnosis is None


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"format": "other"}, "not a message of fgpose/people"),
        ({"version": 2}, "version 1"),
        ({"joints": ("pelvis",)}, "skeleton stick"),
        ({"people": 3}, "damaged message"),
        ({"people": [{"person": 1}]}, "damaged message"),
        ({"cameras": [{"state": "ok"}]}, "damaged message"),
        ({"cameras": [{"state": "tired"}]}, "tired"),
        ({"diagnosis": {"findings": 3}}, "damaged message"),
        ({"diagnosis": {"findings": [{"code": "unit", "severity": "mild"}]}}, "mild"),
    ],
)
def test_what_is_no_such_message_is_refused(change: dict, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        decode_frame(packed(frame_document(frame(1)) | change), SKELETON)


def test_another_skeleton_and_garbage_are_refused() -> None:
    with pytest.raises(ValueError, match="coco_17"):
        decode_frame(encode_frame(frame(1)), load_skeleton("coco_17"))
    with pytest.raises(ValueError, match="MessagePack"):
        decode_frame(encode_frame(frame(1))[:-5], SKELETON)
