"""Training Q-networks: double DQN with hindsight, who pushes and who learns apart."""
