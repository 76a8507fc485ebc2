"""Training Q-networks: double DQN with hindsight, actors and learner apart."""
