"""Training Q-networks: double DQN with hindsight, with collection separate from learning."""
