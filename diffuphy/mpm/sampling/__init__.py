"""From Gaussians to particles: the third stage."""
