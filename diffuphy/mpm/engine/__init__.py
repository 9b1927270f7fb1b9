"""What runs the kernels: launches, frames, time, and what goes wrong in them."""
