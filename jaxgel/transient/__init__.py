"""Time: transient swelling."""
