"""What changes while a recording lasts: clocks that jump or drift, cameras that are bumped; found by the motion."""
