"""Services: objects that are handed messages and return messages."""
