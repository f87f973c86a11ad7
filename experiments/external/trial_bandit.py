# Epsilon-greedy on the mean rewards of everybody's actions, in a trial.
import numpy as np
from jitai import external

job = external.connect(trials=True)
epsilon = job.parameters["epsilon"]


class Greedy:
    shares = np.full(job.actions, 1 / job.actions)
    data = []  # day, person, action and reward of every decision

    def act(self, people, observations):
        return np.tile(self.shares, (len(people), 1))

    def observe(self, people, actions, rewards):
        self.data.append(np.column_stack([np.full(len(people), job.day), people, actions, rewards]))

    def update(self, day, people, before, agent):
        days, persons, actions, rewards = np.concatenate(self.data).T
        counts = (days < before) & np.isin(persons, people) & ~np.isnan(rewards)
        actions, rewards = actions[counts].astype(int), rewards[counts]
        number = np.bincount(actions, minlength=job.actions)
        means = np.bincount(actions, rewards, job.actions) / np.maximum(number, 1)
        self.shares = np.full(job.actions, epsilon / job.actions)
        self.shares[means.argmax()] += 1 - epsilon


job.trial(Greedy())
