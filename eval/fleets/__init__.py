"""Many logs of many aircraft: evaluated into a dataset, and watched for drift."""
