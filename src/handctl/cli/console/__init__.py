"""Code that all commands share: options, output, display, and questions to the operator."""
