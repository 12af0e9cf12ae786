"""The learners, all behind `learner.Learner`; `registry` has one entry for each."""
