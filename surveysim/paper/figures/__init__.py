"""The paper's figures as points."""
