"""What several folders of tests share: it imports none of them."""
