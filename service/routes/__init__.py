"""The REST interface: a file a group of routes, with what they ask and answer. The application alone imports them."""
