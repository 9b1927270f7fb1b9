"""One substep as kernels: matter to nodes, nodes, nodes to matter; and the way back."""
