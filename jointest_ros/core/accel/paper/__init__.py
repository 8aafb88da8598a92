"""The paper's model: three states, measured by w^2 and the force at the joint, online and over many trials."""
