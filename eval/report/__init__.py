"""Report pages: self-contained HTML about an evaluation, a preparation or a cross-validation."""
