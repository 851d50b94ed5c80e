"""An option that a person watches and takes over, on the graph: live, and from the bag."""

from graph_support.live import GAME, Graph, LEARNER, OPTION_SERVER, RECORDER
from graph_support.teaching import Person, PICKUP, START
from humanopts_interfaces.action import ExecuteOption
from humanopts_interfaces.msg import ControlState, GameState, LearnedOptions, LessonState
from humanopts_interfaces.srv import BeginDemonstration, EndDemonstration
from humanopts_learner.options.files import option_from_json
from humanopts_learner.options.learn import learn_option
from humanopts_ros.qos import CURRENT
from humanopts_teach.bags.contents import read_demonstrations, read_domain, read_episodes
from humanopts_teach.bags.reader import open_bag


def test_what_the_machine_showed_is_told_apart_and_the_bag_learns_the_same(live: Graph) -> None:
    recorder = live.start(RECORDER, path=live.folder / 'bag')
    live.start(GAME)
    live.start(LEARNER, directory=live.folder / 'options')
    live.start(OPTION_SERVER)
    person = Person(live)
    person.start_lesson()
    live.ready('/game', '/learner', '/option_server', '/recorder')
    person.get_ready()
    person.show()  # from START: west, pickup
    learned = live.listen(LearnedOptions, 'learned_options', CURRENT)

    def watch(steps: int) -> int:
        nobody = ControlState.HOLDER_NOBODY
        live.until(lambda: person.latest[ControlState].holder == nobody, 'the lease to end')
        begun = person.ask(BeginDemonstration, start_state=START, watch=True)
        assert begun.status == BeginDemonstration.Response.STATUS_OK, begun.detail
        live.act(
            ExecuteOption,
            'execute_option',
            option_name=PICKUP,
            episode=begun.episode,
            max_steps=steps,
        ).result()
        live.until(lambda: person.lesson.machine_steps == steps, "the machine's steps")
        return int(begun.episode)

    def end(episode: int, step: int, *, counts: bool) -> None:
        done = EndDemonstration.Request.VERDICT_DONE
        ended = person.ask(
            EndDemonstration,
            verdict=done,
            episode=episode,
            step=step,
            count_machine_steps=counts,
        )
        assert ended.status == EndDemonstration.Response.STATUS_OK, ended.detail
        live.until(lambda: person.lesson.last_uuid == ended.uuid, 'the lesson to keep it')
        person.phase(LessonState.PHASE_READY)

    episode = watch(1)
    person.drive(episode, 'pickup')
    end(episode, 2, counts=True)
    episode = watch(2)
    end(episode, 2, counts=True)
    newest = person.lesson.last_uuid
    live.until(lambda: learned and newest in learned[-1].options[0].model, 'the option')
    option, _ = option_from_json(learned[-1].options[0].model)
    live.stop(recorder)

    bag = open_bag(live.folder / 'bag')
    demos = {demo.uuid: demo for demo in read_demonstrations(bag)}
    assert [(d.actions, d.machine_steps) for d in demos.values()] == [
        (('west', 'pickup'), 0),
        (('west', 'pickup'), 1),
        (('west', 'pickup'), 2),
    ]
    sources = [
        [int(step.action_source) for step in found.transitions[1:]] for found in read_episodes(bag)
    ]
    person_, machine = GameState.SOURCE_PERSON, GameState.SOURCE_MACHINE
    assert sources[-3:] == [[person_] * 2, [machine, person_], [machine] * 2]
    assert learn_option(list(demos.values()), read_domain(bag), 0) == option
