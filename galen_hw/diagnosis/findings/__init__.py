"""What a model says, where and in which words."""
