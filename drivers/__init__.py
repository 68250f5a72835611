"""The wire: register maps, transports, devices, and a test sequence played on them."""
