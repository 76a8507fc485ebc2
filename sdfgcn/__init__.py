"""Push objects into the arrangement that a goal picture shows, by Q-learning on SDF graphs."""
