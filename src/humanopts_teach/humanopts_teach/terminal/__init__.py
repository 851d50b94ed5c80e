"""The person's terminal as pure code: keys, screens, what they ask of the graph, drawing."""
