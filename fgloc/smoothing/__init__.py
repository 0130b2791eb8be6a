"""The factor graph and the engines that solve it."""
