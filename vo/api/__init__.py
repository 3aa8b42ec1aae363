"""The public interface: what `import vo` gives, and nothing else is meant to be depended on."""
