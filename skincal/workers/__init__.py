"""Workers for independent pieces of work: processes of this machine, or a cluster. Light, so that they start first."""
