"""Which processes make up the graph, and how they are started, watched and stopped."""
