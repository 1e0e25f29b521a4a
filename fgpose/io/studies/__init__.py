"""Files of a study: states of recordings, tables of events and of quality, and the data set."""
