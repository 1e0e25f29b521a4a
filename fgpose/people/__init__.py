"""Several people: who is who, the motion of each, and how right that is.

- In: Detections, everybody in an image; PeopleObservations, all images of a recording, of which MatchedFrames says
  which belong together. PersonRegion names one of several by where somebody stands in an image.
- A whole recording: smooth_people gives SmoothedPeople, with the Association of the detections: each person as Seen.
- Image by image: Tracker gives everybody as Tracked, with a TrackState, and tells each TrackEvent. Its TrackerMemory,
  of each RememberedPerson and with RememberedSimilarity, is what the next one goes on from.
- Against the truth: evaluate_people gives PeopleEvaluation, of each PersonScore, Stay and Encounter; revised calls
  everybody by the number that they have in the end.

Their files are read and written by load_people, save_people, load_memory and save_memory in
fgpose.files.
"""

from fgpose.assessment.encounters import Encounter
from fgpose.assessment.people import PeopleEvaluation, PersonScore, evaluate_people, revised
from fgpose.assessment.stays import Stay
from fgpose.association.chosen_person import PersonRegion
from fgpose.association.recording import Association
from fgpose.association.track import TrackEvent, TrackState
from fgpose.correspondences import MatchedFrames, Seen
from fgpose.io.live.tracker_memory import RememberedPerson, RememberedSimilarity, TrackerMemory
from fgpose.people_observations import Detections, PeopleObservations
from fgpose.tracking import SmoothedPeople, Tracked, Tracker, smooth_people

__all__ = [
    "Association",
    "Detections",
    "Encounter",
    "MatchedFrames",
    "PeopleEvaluation",
    "PeopleObservations",
    "PersonRegion",
    "PersonScore",
    "RememberedPerson",
    "RememberedSimilarity",
    "Seen",
    "SmoothedPeople",
    "Stay",
    "TrackEvent",
    "TrackState",
    "Tracked",
    "Tracker",
    "TrackerMemory",
    "evaluate_people",
    "revised",
    "smooth_people",
]
