"""Several people: who is who, and the motion of each."""

from fgpose.association.track import Tracked as Tracked
from fgpose.tracking.batch import SmoothedPeople as SmoothedPeople
from fgpose.tracking.batch import smooth_people as smooth_people
from fgpose.tracking.online import Tracker as Tracker
