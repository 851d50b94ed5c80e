from pathlib import Path
import sys
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = 'humanopts_env'
MANIFEST = ElementTree.parse('package.xml')
# Executables of ros2 run, which is not there where wheels are installed.
NODES = [
    'game = humanopts_env.ros.game_node:main',
    'world = humanopts_env.ros.world_node:main',
]
SCRIPTS = [] if 'bdist_wheel' in sys.argv else NODES

setup(
    name=NAME,
    version=MANIFEST.findtext('version'),
    description=MANIFEST.findtext('description'),
    long_description=Path('README.md').read_text('utf-8'),
    long_description_content_type='text/markdown',
    license=MANIFEST.findtext('license'),
    install_requires=[
        'humanopts-ros',
        'lazy-loader>=0.3',
        'numpy>=1.26.4',
        'pydantic>=2.7',
        'scipy>=1.11.4',
        'typing-extensions',
    ],
    python_requires='>=3.11',
    packages=find_packages(exclude=['test']),
    package_data={NAME: ['py.typed', '__init__.pyi', 'mazes/*.lay']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
    extras_require={'worlds': ['gymnasium[box2d]>=1', 'minigrid>=3']},
    entry_points={
        'console_scripts': SCRIPTS,
        'humanopts.domains': [
            'pacman = humanopts_env.domains.pacman.domain:PacMan',
            'rooms = humanopts_env.domains.rooms:Rooms',
            'taxi = humanopts_env.domains.taxi:Taxi',
        ],
        'humanopts.reference_options': [
            'gymnasium = humanopts_env.domains.gymnasium_reference:reference_options',
            'pacman = humanopts_env.domains.pacman.reference:reference_options',
            'rooms = humanopts_env.domains.rooms_reference:reference_options',
            'taxi = humanopts_env.domains.taxi_reference:reference_options',
        ],
        'humanopts.features': [
            'minigrid = humanopts_env.domains.minigrid_features:features',
        ],
    },
)
