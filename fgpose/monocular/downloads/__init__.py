"""What is fetched once from packages of registries, into the cache of the user: weights of networks, and videos."""
