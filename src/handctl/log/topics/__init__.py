"""Topics of a log: conversion of batches of ticks to blocks of messages."""
