"""Videos with the estimated people drawn into their images."""
