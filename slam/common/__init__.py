"""Parts that every stage uses: configuration, errors, arrays, rigid transforms."""
