"""From a sentence to Gaussians: refine the words, then fit what they describe."""
