"""The recordings as one campaign: where they come from, what they cover, which motions are independent."""
