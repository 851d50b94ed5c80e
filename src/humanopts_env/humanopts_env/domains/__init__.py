"""Games as pure rules: the protocol, the registered domains and their reference options."""
