"""What works beside the service: processes for analyses, and who gets a processor first."""
