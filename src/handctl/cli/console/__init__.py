"""Parts common to all verbs: options, output, display, and questions to the operator."""
