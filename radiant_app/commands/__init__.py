"""What each command does, as a function; the command line parses, calls one and prints."""
