"""What a rollout shows: metrics, the paper's figures and claims, an animation."""
