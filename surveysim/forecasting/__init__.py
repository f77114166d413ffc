"""The noise forecast: the noise of a survey's maps in closed form, without a Monte Carlo."""
