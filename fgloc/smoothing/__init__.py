"""The smoothers: the graph as factor tables, and the engines that solve it."""
