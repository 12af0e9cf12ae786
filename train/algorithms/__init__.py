"""The learning algorithms, all with the interface `learner.Learner`; `registry` lists them."""
