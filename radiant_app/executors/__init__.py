"""Where the nodes of a tree run; what they compute is not decided here."""
