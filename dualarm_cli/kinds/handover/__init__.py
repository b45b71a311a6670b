"""Parts that go from one arm's tool into the other's."""
