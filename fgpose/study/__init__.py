"""Many recordings: found by patterns, estimated on all cores or on a cluster, and put together in one data set."""
